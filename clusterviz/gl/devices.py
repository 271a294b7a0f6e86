"""EGL devices of a node, and the choice of a rank's device.

Four ranks on a node with four GPUs should use all four, but by default EGL gives each rank its first device. The order
is that of `eglQueryDevicesEXT`, which the device index of moderngl's EGL backend uses. CUDA's order may differ, so the
CUDA number is listed too. Listing devices needs no context and no OpenGL.

References
----------
EGL_EXT_device_enumeration, EGL_EXT_device_query, EGL_EXT_device_drm, EGL_EXT_device_drm_render_node,
EGL_EXT_device_query_name, EGL_NV_device_cuda and EGL_MESA_device_software, in the Khronos registry.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Mapping, Sequence
from ctypes.util import find_library
from dataclasses import dataclass
from typing import Any, Literal

from clusterviz.errors import DeviceError, InputError

ENVIRONMENT = "CLUSTERVIZ_EGL_DEVICE"
INSTALL_HINT = (
    "install a GPU driver with EGL, or Mesa's (Debian, Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri)"
)

_EXTENSIONS, _VENDOR, _RENDERER = 0x3055, 0x3053, 0x335F
_DRM_DEVICE_FILE, _DRM_RENDER_NODE_FILE, _CUDA_DEVICE = 0x3233, 0x3377, 0x323A
_MOST_DEVICES = 128


Device = int | Literal["cpu"] | None
"""Device to draw on, as a user sets it: an EGL device by its index, the CPU, or None for the best one."""


@dataclass(frozen=True)
class EglDevice:
    """One EGL device.

    Attributes
    ----------
    index : position in `eglQueryDevicesEXT`, the device index that a context is made with
    software : True for Mesa's llvmpipe, which draws on the CPU
    drm_node : "/dev/dri/renderD128" or similar; "" if the driver names none
    cuda_id : CUDA's number of the same device, None if it has none
    renderer, vendor : the driver's names, "" if it gives none before a context exists
    extensions : the device extensions
    """

    index: int
    software: bool
    drm_node: str = ""
    cuda_id: int | None = None
    renderer: str = ""
    vendor: str = ""
    extensions: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Description for users: "software", "hardware, /dev/dri/renderD128, CUDA 0"."""
        kind = "software" if self.software else "hardware"
        cuda = "" if self.cuda_id is None else f"CUDA {self.cuda_id}"
        return ", ".join(filter(None, (kind, self.renderer or self.vendor, self.drm_node, cuda)))


def egl_devices() -> tuple[EglDevice, ...]:
    """Return the EGL devices of this node, in EGL's order; empty if EGL lists none.

    Raises
    ------
    DeviceError
        libEGL is missing, or has no driver that lists devices.
    """
    name = find_library("EGL")
    if name is None:
        raise DeviceError(f"there is no EGL library; {INSTALL_HINT}")
    egl = _Egl(ctypes.CDLL(name))
    return tuple(_describe(egl, index, handle) for index, handle in enumerate(egl.handles()))


def has_gpu() -> bool:
    """Return True if EGL lists hardware on this node."""
    try:
        return any(not device.software for device in egl_devices())
    except DeviceError:
        return False


def preferred_renderer(device: Device = None, environment: Mapping[str, str] | None = None) -> str:
    """Return the ray caster that a rank prefers, "CPU" or "OpenGL", and why, in a few words.

    Parameters
    ----------
    device : the user's setting; if it is None and CLUSTERVIZ_EGL_DEVICE names a device, OpenGL draws on that
    environment : variables to read, this process's own by default
    """
    variables = os.environ if environment is None else environment
    if isinstance(device, int) or (device is None and variables.get(ENVIRONMENT, "").strip()):
        return "OpenGL, asked for"
    if device == "cpu":
        return "CPU, asked for"
    return "OpenGL, as there is a GPU" if has_gpu() else "CPU, as there is no GPU"


def prefers_cpu(device: Device = None, environment: Mapping[str, str] | None = None) -> bool:
    """Return True if a rank prefers the CPU ray caster to OpenGL; parameters as for `preferred_renderer`."""
    return preferred_renderer(device, environment).startswith("CPU")


def egl_device(device: Device) -> int | None:
    """Return the EGL device of a setting; EGL's default for the CPU."""
    return None if device == "cpu" else device


def choose_device(
    devices: Sequence[EglDevice],
    local_rank: int,
    override: int | None = None,
    environment: Mapping[str, str] | None = None,
) -> int:
    """Return the index of a rank's device: the requested one, else hardware round robin, else the software device.

    Parameters
    ----------
    devices : devices of `egl_devices`
    local_rank : index of the rank on its node, from 0
    override : index that the user requested; by default that of CLUSTERVIZ_EGL_DEVICE
    environment : environment variables, this process's own by default

    Raises
    ------
    DeviceError
        There is no device at all.
    InputError
        The override names a device that does not exist.
    """
    if not devices:
        raise DeviceError(f"EGL lists no device; {INSTALL_HINT}")
    asked, where = override, "EGL device"
    if asked is None:
        asked, where = _asked_in(os.environ if environment is None else environment), ENVIRONMENT
    if asked is not None:
        if not 0 <= asked < len(devices):
            raise InputError(
                "no such EGL device", where=where, found=asked, allowed=f"0 to {len(devices) - 1}" if devices[1:] else 0
            )
        return asked
    pool = [device for device in devices if not device.software] or list(devices)
    return pool[local_rank % len(pool)].index


def _asked_in(environment: Mapping[str, str]) -> int | None:
    """Return the device index in CLUSTERVIZ_EGL_DEVICE, None if that is unset or empty."""
    text = environment.get(ENVIRONMENT, "").strip()
    if not text:
        return None
    if not text.isdecimal():
        raise InputError("not a device index", where=ENVIRONMENT, found=repr(text), allowed="0, 1, 2, …")
    return int(text)


class _Egl:
    """EGL entry points that list devices, with their C types."""

    def __init__(self, library: ctypes.CDLL) -> None:
        library.eglGetProcAddress.restype = ctypes.c_void_p
        library.eglGetProcAddress.argtypes = [ctypes.c_char_p]
        self._library = library
        pointer, integer = ctypes.c_void_p, ctypes.c_int
        self._query_devices = self._entry(
            "eglQueryDevicesEXT", ctypes.c_uint, integer, ctypes.POINTER(pointer), ctypes.POINTER(integer)
        )
        self._query_string = self._entry("eglQueryDeviceStringEXT", ctypes.c_char_p, pointer, integer)
        self._query_attribute = self._entry(
            "eglQueryDeviceAttribEXT", ctypes.c_uint, pointer, integer, ctypes.POINTER(ctypes.c_ssize_t)
        )

    def _entry(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        address = self._library.eglGetProcAddress(name.encode())
        if not address:
            raise DeviceError(f"EGL cannot list devices, for want of a driver: it lacks {name}; {INSTALL_HINT}")
        return ctypes.CFUNCTYPE(result, *arguments)(address)

    def handles(self) -> list[int]:
        """Return the opaque device handles, in EGL's order."""
        found = (ctypes.c_void_p * _MOST_DEVICES)()
        count = ctypes.c_int(0)
        if not self._query_devices(_MOST_DEVICES, found, ctypes.byref(count)):
            return []
        return [int(handle) for handle in found[: count.value] if handle]

    def string(self, handle: int, name: int) -> str:
        """Return one of the device's strings, "" if it has none."""
        text: bytes | None = self._query_string(handle, name)
        return (text or b"").decode(errors="replace")

    def attribute(self, handle: int, name: int) -> int | None:
        """Return one of the device's numbers, None if it has none."""
        value = ctypes.c_ssize_t(0)
        return value.value if self._query_attribute(handle, name, ctypes.byref(value)) else None


def _describe(egl: _Egl, index: int, handle: int) -> EglDevice:
    extensions = tuple(egl.string(handle, _EXTENSIONS).split())
    # A string may only be queried if its extension is listed; other names are EGL errors.
    drm_node = egl.string(handle, _DRM_RENDER_NODE_FILE) if "EGL_EXT_device_drm_render_node" in extensions else ""
    if not drm_node and "EGL_EXT_device_drm" in extensions:
        drm_node = egl.string(handle, _DRM_DEVICE_FILE)
    named = "EGL_EXT_device_query_name" in extensions
    return EglDevice(
        index=index,
        software="EGL_MESA_device_software" in extensions,
        drm_node=drm_node,
        cuda_id=egl.attribute(handle, _CUDA_DEVICE) if "EGL_NV_device_cuda" in extensions else None,
        renderer=egl.string(handle, _RENDERER) if named else "",
        vendor=egl.string(handle, _VENDOR) if named else "",
        extensions=extensions,
    )
