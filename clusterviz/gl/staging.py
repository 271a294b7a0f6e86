"""Memory of the host into which OpenGL copies parts of buffers: mapped for good where a driver can, else read at once.

A mapped buffer is pinned memory that the device writes by itself. The host waits for a fence behind the copies, not for
all that is queued after them.

References
----------
Khronos Group, GL_ARB_buffer_storage and GL_ARB_sync.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import c_int, c_ssize_t, c_uint, c_uint64, c_void_p
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError
from clusterviz.gl.compute import finish, gl_function

EXTENSION = "GL_ARB_buffer_storage"
Bytes = NDArray[np.uint8]
Part = tuple[moderngl.Buffer, int, int]
"""A buffer, the first byte, and the number of bytes."""
_FROM, _TO = 0x8F36, 0x8F37  # GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER
_MAPPED = 0x0001 | 0x0040 | 0x0080  # GL_MAP_READ_BIT, GL_MAP_PERSISTENT_BIT, GL_MAP_COHERENT_BIT
_IN_HOST_MEMORY = 0x0200  # GL_CLIENT_STORAGE_BIT
_COMMANDS_COMPLETE, _FLUSH = 0x9117, 0x1
_TIMEOUT_EXPIRED, _WAIT_FAILED = 0x911B, 0x911D
_NANOSECONDS = 10**9
_ALIGNED = 16
GROWTH = 1.25


@dataclass
class Copies:
    """Parts of buffers that are on their way to the host.

    Attributes
    ----------
    parts : what is copied
    is_mapped : whether the bytes lie in memory that is used again
    """

    parts: Sequence[Part]
    _context: moderngl.Context
    _memory: Bytes | None = None
    _fence: Any = None
    _found: list[Bytes] = field(default_factory=list)

    @property
    def is_mapped(self) -> bool:
        return self._memory is not None

    def wait(self) -> list[Bytes]:
        """Return the bytes of each part when they have arrived; until then, Python's lock is released.

        Mapped ones are valid until the memory is used again, see `Staging.copy`.

        Raises
        ------
        DeviceError
            The driver gave up, as when the device is lost.
        """
        if self._found:
            return self._found
        if self._memory is None:
            finish(self._context)
            self._found = [np.frombuffer(buffer.read(size, offset=at), np.uint8) for buffer, at, size in self.parts]
            return self._found
        gl, fence = _functions(), self._fence
        while (state := gl.wait(fence, _FLUSH, _NANOSECONDS)) == _TIMEOUT_EXPIRED:
            pass
        gl.delete_fence(fence)
        if state == _WAIT_FAILED:
            raise DeviceError("OpenGL failed while a picture was read back; the device may be lost")
        begins = _begins(self.parts)
        self._found = [self._memory[at : at + size] for at, (_, _, size) in zip(begins, self.parts, strict=False)]
        return self._found


class Staging:
    """A ring of memories of the host that receive copies.

    Parameters
    ----------
    context : a context that this thread has current, or that of a recording
    is_mapped : whether memory stays mapped; None: if the driver can
    length : copies that may be on their way, or in use, at the same time

    Attributes
    ----------
    is_mapped : whether memory stays mapped
    made : buffers that were made
    """

    def __init__(self, context: moderngl.Context, is_mapped: bool | None = None, length: int = 2) -> None:
        self._context = context
        can = isinstance(context, moderngl.Context) and EXTENSION in context.extensions
        self.is_mapped = can if is_mapped is None else is_mapped and can
        self._ring: list[tuple[int, Bytes] | None] = [None] * length
        self._next = self.made = 0

    def copy(self, parts: Sequence[Part]) -> Copies:
        """Queue copies of parts of buffers behind all that was queued before.

        The memory is that of the copies `length` calls before, which must not be in use any more.
        """
        if not self.is_mapped:
            return Copies(parts, self._context)
        size = _begins(parts)[-1]
        place, self._next = self._next, (self._next + 1) % len(self._ring)
        held = self._ring[place]
        if held is None or held[1].size < size:
            self._free(place)
            held = self._ring[place] = _mapped(int(GROWTH * size))
            self.made += 1
        gl = _functions()
        gl.bind(_TO, held[0])
        for (buffer, begin, count), target in zip(parts, _begins(parts), strict=False):
            gl.bind(_FROM, buffer.glo)
            gl.copy(_FROM, _TO, begin, target, count)
        return Copies(parts, self._context, held[1], gl.fence(_COMMANDS_COMPLETE, 0))

    def release(self) -> None:
        """Free the memory; arrays in it are no longer valid."""
        for place in range(len(self._ring)):
            self._free(place)

    def _free(self, place: int) -> None:
        if held := self._ring[place]:
            _functions().delete(1, ctypes.byref(c_uint(held[0])))
        self._ring[place] = None


def _begins(parts: Sequence[Part]) -> list[int]:
    """Return where each part begins in memory, and the end of the last."""
    begins = [0]
    for _, _, size in parts:
        begins.append(begins[-1] + -(-size // _ALIGNED) * _ALIGNED)
    return begins


def _mapped(size: int) -> tuple[int, Bytes]:
    """Return a buffer that stays mapped, and its memory.

    Raises
    ------
    DeviceError
        The driver has no memory for it.
    """
    gl, name = _functions(), c_uint()
    gl.generate(1, ctypes.byref(name))
    gl.bind(_TO, name)
    gl.store(_TO, size, None, _MAPPED | _IN_HOST_MEMORY)
    address = gl.map(_TO, 0, size, _MAPPED)
    if not address:
        gl.delete(1, ctypes.byref(name))
        raise DeviceError(f"OpenGL has no memory for reading pictures back: {size} bytes")
    return name.value, np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_uint8)), (size,))


@dataclass(frozen=True)
class _Functions:
    """OpenGL's functions that moderngl does not offer; calls release Python's lock."""

    generate: Any
    bind: Any
    store: Any
    map: Any
    copy: Any
    delete: Any
    fence: Any
    wait: Any
    delete_fence: Any


@cache
def _functions() -> _Functions:
    return _Functions(
        gl_function("glGenBuffers", c_int, c_void_p),
        gl_function("glBindBuffer", c_uint, c_uint),
        gl_function("glBufferStorage", c_uint, c_ssize_t, c_void_p, c_uint),
        gl_function("glMapBufferRange", c_uint, c_ssize_t, c_ssize_t, c_uint, result=c_void_p),
        gl_function("glCopyBufferSubData", c_uint, c_uint, c_ssize_t, c_ssize_t, c_ssize_t),
        gl_function("glDeleteBuffers", c_int, c_void_p),
        gl_function("glFenceSync", c_uint, c_uint, result=c_void_p),
        gl_function("glClientWaitSync", c_void_p, c_uint, c_uint64, result=c_uint),
        gl_function("glDeleteSync", c_void_p),
    )
