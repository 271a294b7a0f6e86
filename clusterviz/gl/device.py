"""What one OpenGL context holds from draw to draw: buffers and tables by binding; and the calls that it took.

A draw names its data by binding. A buffer is made when a binding is first used or has to grow, and stays; data that
did not change are not uploaded again. Dispatches are queued, and only `read` waits for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.compute import queue_compute
from clusterviz.gl.staging import GROWTH, Bytes, Copies, Part, Staging

Kind = Literal["storage", "uniform"]
LEAST_BYTES = 16
"""OpenGL has no buffers without bytes."""
COMPARED_BYTES = 1 << 16
"""Larger data are known again only if they are one array that cannot be written."""


@dataclass
class Counts:
    """Calls of OpenGL, and bytes that they moved.

    Attributes
    ----------
    dispatches : dispatches and draw calls
    waits : places in which the host waited for the device
    made : buffers and textures made
    uploaded, read : bytes to and from the device
    """

    dispatches: int = 0
    waits: int = 0
    made: int = 0
    uploaded: int = 0
    read: int = 0

    def since(self, earlier: Counts) -> Counts:
        """Return the calls after an earlier time."""
        before = asdict(earlier)
        return Counts(**{name: count - before[name] for name, count in asdict(self).items()})


@dataclass
class _Held:
    """A buffer or a table, and what was last given to it, if that is known."""

    made: Any
    capacity: int | tuple[int, ...]
    given: NDArray[Any] | bytes | None = None


class Device:
    """Buffers, tables and dispatches of a context.

    Parameters
    ----------
    context : a context that this thread has current, or that of a recording
    is_mapped : as in `Staging`

    Attributes
    ----------
    context : the same
    counts : what was done since the device was made
    """

    def __init__(self, context: moderngl.Context, is_mapped: bool | None = None) -> None:
        self.context, self.counts = context, Counts()
        self._staging = Staging(context, is_mapped)
        self._held: dict[tuple[str, int], _Held] = {}

    def give(self, binding: int, data: NDArray[Any], kind: Kind = "storage") -> moderngl.Buffer:
        """Bind data that shaders only read.

        They are uploaded unless they are those of the last call: the same array, made read-only by its owner, or equal
        bytes of at most `COMPARED_BYTES`.
        """
        held = self._at_least(kind, binding, data.nbytes)
        if not _is_known(held.given, data):
            held.made.write(data.tobytes() or bytes(LEAST_BYTES))
            self.counts.uploaded += data.nbytes
            held.given = _remembered(data)
        return self._bound(held, kind, binding, data.nbytes)

    def begin(self, binding: int, data: NDArray[Any]) -> moderngl.Buffer:
        """Bind a storage buffer that shaders write, with its data at the start."""
        buffer = self.reserve(binding, data.nbytes)
        buffer.write(data.tobytes() or bytes(LEAST_BYTES))
        self.counts.uploaded += data.nbytes
        return buffer

    def reserve(self, binding: int, size: int) -> moderngl.Buffer:
        """Bind a storage buffer of at least `size` bytes, whose contents are those of earlier draws or undefined."""
        held = self._at_least("storage", binding, size)
        held.given = None
        return self._bound(held, "storage", binding, size)

    def table(self, unit: int, texels: NDArray[np.float32]) -> moderngl.Texture:
        """Bind a texture of float32 (h, w, 4), read without filtering; known again as by `give`."""
        held = self._held.get(("table", unit))
        if held is None or held.capacity != texels.shape:
            if held:
                held.made.release()
            made = self.context.texture(texels.shape[1::-1], 4, texels.tobytes(), dtype="f4")
            made.filter = (moderngl.NEAREST, moderngl.NEAREST)
            held = self._held["table", unit] = _Held(made, texels.shape)
            self.counts.made += 1
            self.counts.uploaded += texels.nbytes
        elif not _is_known(held.given, texels):
            held.made.write(texels.tobytes())
            self.counts.uploaded += texels.nbytes
        held.given = _remembered(texels)
        held.made.use(unit)
        return held.made

    def dispatch(self, program: moderngl.ComputeShader, groups: tuple[int, ...]) -> None:
        """Queue work groups of a program behind all that was queued before, whose writes they see."""
        queue_compute(program, groups)
        self.context.memory_barrier()
        self.counts.dispatches += 1

    def copy(self, parts: Sequence[Part]) -> Copies:
        """Queue copies of parts of buffers to the host, where `arrived` returns them."""
        before = self._staging.made
        copies = self._staging.copy(parts)
        self.counts.made += self._staging.made - before
        return copies

    def arrived(self, copies: Copies) -> list[Bytes]:
        """Wait, without Python's lock, and return the bytes of copies; they stay until two more have been queued."""
        found = copies.wait()
        self.counts.waits += 1
        self.counts.read += sum(each.nbytes for each in found)
        return found

    def read(self, buffer: moderngl.Buffer, size: int = -1, offset: int = 0) -> bytes:
        """Wait until all that is queued is done, without Python's lock, and return bytes of a buffer."""
        size = buffer.size - offset if size < 0 else size
        return self.arrived(self.copy([(buffer, offset, size)]))[0].tobytes()

    def release(self) -> None:
        """Free all buffers and tables."""
        self._staging.release()
        for held in self._held.values():
            held.made.release()
        self._held.clear()

    def _at_least(self, kind: Kind, binding: int, size: int) -> _Held:
        """Return the buffer of a binding, made again if it is too small."""
        held = self._held.get((kind, binding))
        if held is None or held.capacity < size:  # type: ignore[operator]
            capacity = max(LEAST_BYTES, size if held is None else int(GROWTH * size))
            if held:
                held.made.release()
            held = self._held[kind, binding] = _Held(self.context.buffer(reserve=capacity), capacity)
            self.counts.made += 1
        return held

    def _bound(self, held: _Held, kind: Kind, binding: int, size: int) -> moderngl.Buffer:
        """Bind the part of a buffer that holds data."""
        size = max(LEAST_BYTES, size)
        if kind == "uniform":
            held.made.bind_to_uniform_block(binding, size=size)
        else:
            held.made.bind_to_storage_buffer(binding, size=size)
        return held.made


def _remembered(data: NDArray[Any]) -> NDArray[Any] | bytes | None:
    """Return by what data are known again; None: they are not."""
    if data.nbytes <= COMPARED_BYTES:
        return data.tobytes()
    return None if data.flags.writeable else data


def _is_known(given: NDArray[Any] | bytes | None, data: NDArray[Any]) -> bool:
    """Return True if data are those that were given last."""
    if isinstance(given, bytes):
        return len(given) == data.nbytes and given == data.tobytes()
    return given is not None and given is data and not data.flags.writeable
