"""Headless OpenGL context: EGL on a GPU, or Mesa's llvmpipe if there is none.

References
----------
Khronos Group, EGL_EXT_platform_device and EGL_EXT_device_enumeration.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from functools import cache
from typing import Any

import moderngl

from clusterviz.errors import ClustervizError, DeviceError
from clusterviz.gl.devices import choose_device, egl_devices
from clusterviz.spmd.source import ShaderSource

_DRAW, _READ = 0x3059, 0x305A  # surfaces of EGL
LLVMPIPE_ITERATIONS = 65535
"""Iterations of all loops of an invocation together, after which llvmpipe leaves loops without a message."""
HINT = "install Mesa's EGL driver (Debian, Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri) or a driver with EGL"


def open_context(local_rank: int = 0, device: int | None = None) -> moderngl.Context:
    """Open a context on this rank's EGL device.

    Parameters
    ----------
    local_rank : index of this rank on its node; GPUs are assigned round robin by it
    device : EGL device index that overrides the assignment; so does CLUSTERVIZ_EGL_DEVICE

    Raises
    ------
    DeviceError
        There is no EGL, or its OpenGL is older than 4.3.
    """
    try:
        settings: dict[str, Any] = {"backend": "egl", "device_index": choose_device(egl_devices(), local_rank, device)}
        return moderngl.create_context(require=430, standalone=True, **settings)
    except ClustervizError:
        raise
    except Exception as error:
        raise DeviceError(
            f"no OpenGL context could be made through EGL: {_older(settings) or f'{error}; {HINT}'}"
        ) from error


def _older(settings: dict[str, Any]) -> str:
    """Return which OpenGL a device has that is too old, in one text; "" if there is none."""
    try:
        context = moderngl.create_context(require=300, standalone=True, **settings)
    except Exception:
        return ""
    found = f"{context.info['GL_RENDERER']} has {context.info['GL_VERSION']}"
    context.release()
    return f"{found}; allowed 4.3 and later, another device, or the CPU (--device cpu)"


def is_llvmpipe(renderer: str) -> bool:
    """Return True if a device, by OpenGL's name of it, silently leaves all loops after 65535 iterations in total."""
    return "llvmpipe" in renderer


def is_software(renderer: str) -> bool:
    """Return True if a device, by OpenGL's name of it, draws on the CPU, or only records."""
    return is_llvmpipe(renderer) or any(name in renderer for name in ("softpipe", "recording"))


@contextmanager
def current_context_kept() -> Iterator[None]:
    """Context after which this thread's current OpenGL context is the same as before, if there was one."""
    egl = _egl()
    before, display = egl.eglGetCurrentContext(), egl.eglGetCurrentDisplay()
    surfaces = [egl.eglGetCurrentSurface(which) for which in (_DRAW, _READ)]
    try:
        yield
    finally:
        if before:
            egl.eglMakeCurrent(display, *surfaces, before)


@contextmanager
def own_context(context: moderngl.Context) -> Iterator[None]:
    """Context in which an OpenGL context is this thread's current one; afterwards that is what it was before."""
    with current_context_kept():
        context.__enter__()  # whose exit would leave none current
        yield


@cache
def _egl() -> ctypes.CDLL:
    """Return EGL's library, with the types of the functions for current contexts."""
    egl, pointer = ctypes.CDLL(find_library("EGL") or "libEGL.so.1"), ctypes.c_void_p
    egl.eglGetCurrentContext.restype = egl.eglGetCurrentDisplay.restype = egl.eglGetCurrentSurface.restype = pointer
    egl.eglGetCurrentSurface.argtypes = [ctypes.c_int]
    egl.eglMakeCurrent.argtypes = [pointer] * 4
    return egl


def compile_compute(context: moderngl.Context, source: ShaderSource) -> moderngl.ComputeShader:
    """Compile a compute shader; error messages name the shader's files and lines.

    Raises
    ------
    DeviceError
        The driver refuses the source.
    """
    if hasattr(context, "compiled"):  # the draw is recorded
        return context.compiled(source)
    try:
        return context.compute_shader(source.text)
    except moderngl.Error as error:
        raise DeviceError(source.explain(str(error))) from None
