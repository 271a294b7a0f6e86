"""Exit status 0 if some EGL device of this machine gives an OpenGL context; else 1, and why.

`launch/setup` runs it with the system's Python before anything is installed, so it uses the standard library alone.
Mesa lists a software device even where its driver is missing: only a context tells.
"""

from __future__ import annotations

import ctypes
import sys
from ctypes import c_int, c_void_p
from ctypes.util import find_library

PLATFORM_DEVICE, OPENGL_API, NONE = 0x313F, 0x30A2, 0x3038
SURFACE_TYPE, PBUFFER, RENDERABLE_TYPE, OPENGL_BIT = 0x3033, 0x0001, 0x3040, 0x0008
CORE_4_3 = (0x3098, 4, 0x30FB, 3, 0x30FD, 1, NONE)


def reason_for_no_context() -> str:
    """Why no device gives a context; "" if one does."""
    for name in ("EGL", "GL"):
        if find_library(name) is None:
            return f"lib{name} not found"
    egl = ctypes.CDLL(find_library("EGL"))
    for function in ("eglGetProcAddress", "eglCreateContext"):
        getattr(egl, function).restype = c_void_p
    query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    display_of = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query or not display_of:
        return "libEGL cannot list devices"
    devices, count = (c_void_p * 64)(), c_int()
    ctypes.CFUNCTYPE(c_int, c_int, c_void_p, c_void_p)(query)(64, devices, ctypes.byref(count))
    get_display = ctypes.CFUNCTYPE(c_void_p, c_int, c_void_p, c_void_p)(display_of)
    if any(
        gives_context(egl, c_void_p(get_display(PLATFORM_DEVICE, device, None))) for device in devices[: count.value]
    ):
        return ""
    return f"EGL lists {count.value} devices, and none gives an OpenGL 4.3 context: no driver"


def gives_context(egl: ctypes.CDLL, display: c_void_p) -> bool:
    """Whether an EGL display can be started and holds an OpenGL 4.3 core context."""
    if not display or not egl.eglInitialize(display, None, None):
        return False
    wanted = (c_int * 5)(SURFACE_TYPE, PBUFFER, RENDERABLE_TYPE, OPENGL_BIT, NONE)
    config, count = c_void_p(), c_int()
    egl.eglChooseConfig(display, wanted, ctypes.byref(config), 1, ctypes.byref(count))
    egl.eglBindAPI(OPENGL_API)
    return bool(egl.eglCreateContext(display, config, None, (c_int * len(CORE_4_3))(*CORE_4_3)))


if __name__ == "__main__":
    sys.exit(reason_for_no_context() or 0)
