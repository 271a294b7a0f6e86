"""What one OpenGL context holds from draw to draw: buffers and tables by name; and the calls that it took.

A draw names its data as the shaders do (`ShaderSource.blocks`), and a dispatch binds what its program declares. Buffers
are made when a name is first used or has to grow, and stay; data that did not change are not uploaded again. Dispatches
are queued, and only `read` waits for them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import FullDeviceError
from clusterviz.gl.compute import clear_buffer, queue_compute
from clusterviz.gl.drawing import EmptyTarget, compile_program
from clusterviz.gl.driver_needs import compile_checked
from clusterviz.gl.staging import GROWTH, Bytes, Copies, Part, Staging
from clusterviz.spmd.source import Binding, ShaderSource

LEAST_BYTES = 16
"""OpenGL has no buffers without bytes."""
COMPARED_BYTES = 1 << 18
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


@dataclass(frozen=True, eq=False)
class Program:
    """A program of OpenGL, and the bindings of what it declares by name."""

    made: Any
    blocks: Mapping[str, Binding]

    def release(self) -> None:
        """Free it."""
        self.made.release()


@dataclass
class _Held:
    """A buffer or a table, and what was last given to it, if that is known."""

    made: Any
    shape: tuple[int, ...] = ()
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

    Raises
    ------
    FullDeviceError
        By whatever makes a buffer: the device has no memory for it.
    """

    def __init__(self, context: moderngl.Context, is_mapped: bool | None = None) -> None:
        self.context, self.counts = context, Counts()
        self._staging = Staging(context, is_mapped)
        self._held: dict[str, _Held] = {}
        self._bound: dict[str, tuple[Any, int]] = {}
        self._target: EmptyTarget | None = None

    def compile(self, source: ShaderSource) -> Program:
        """Compile a compute shader; errors as of `compile_checked`."""
        return Program(compile_checked(self.context, source), source.blocks)

    def compile_stages(self, vertices: ShaderSource, fragments: ShaderSource) -> Program:
        """Compile a vertex and a fragment shader; errors as of `compile_program`."""
        return Program(compile_program(self.context, vertices, fragments), vertices.blocks | fragments.blocks)

    def give(self, name: str, data: NDArray[Any]) -> moderngl.Buffer:
        """Hold data that shaders only read.

        They are uploaded unless they are those of the last call: the same array, made read-only by its owner, or equal
        bytes of at most `COMPARED_BYTES`.
        """
        held = self._at_least(name, data.nbytes)
        if not _is_known(held.given, data):
            held.made.write(data.tobytes() or bytes(LEAST_BYTES))
            self.counts.uploaded += data.nbytes
            held.given = _remembered(data)
        return self.bind(name, held.made, data.nbytes)

    def begin(self, name: str, data: NDArray[Any]) -> moderngl.Buffer:
        """Hold a storage buffer that shaders write, with its data at the start."""
        buffer = self.reserve(name, data.nbytes)
        buffer.write(data.tobytes() or bytes(LEAST_BYTES))
        self.counts.uploaded += data.nbytes
        return buffer

    def reserve(self, name: str, size: int, *, keeps: bool = False) -> moderngl.Buffer:
        """Hold a storage buffer of at least `size` bytes, whose contents are those of earlier draws or undefined.

        Parameters
        ----------
        keeps : a buffer that grows keeps its contents
        """
        held = self._at_least(name, size, keeps=keeps)
        held.given = None
        return self.bind(name, held.made, size)

    def bind(self, name: str, made: Any, size: int = -1) -> Any:
        """Let a name stand for a buffer, or for its first bytes, or for a texture, also of another owner."""
        self._bound[name] = made, size if size < 0 else max(LEAST_BYTES, size)
        return made

    def write(self, buffer: moderngl.Buffer, data: NDArray[Any], offset: int = 0) -> None:
        """Write a part of a buffer that `reserve` has returned, behind all that is queued."""
        if data.nbytes:
            buffer.write(data.tobytes(), offset=offset)
            self.counts.uploaded += data.nbytes

    def clear(self, buffer: moderngl.Buffer, size: int, offset: int = 0) -> None:
        """Fill `size` bytes with zeros on the device; both are multiples of 4."""
        if size:
            clear_buffer(self.context, buffer, size, offset)

    def table(self, name: str, texels: NDArray[np.float32]) -> moderngl.Texture:
        """Hold a texture of float32 (h, w, 4), read without filtering; known again as by `give`."""
        held = self._held.get(name)
        if held is None or held.shape != texels.shape:
            if held:
                held.made.release()
            made = self.context.texture(texels.shape[1::-1], 4, texels.tobytes(), dtype="f4")
            made.filter = (moderngl.NEAREST, moderngl.NEAREST)
            held = self._held[name] = _Held(made, texels.shape)
            self.counts.made += 1
            self.counts.uploaded += texels.nbytes
        elif not _is_known(held.given, texels):
            held.made.write(texels.tobytes())
            self.counts.uploaded += texels.nbytes
        held.given = _remembered(texels)
        self.bind(name, held.made)
        return held.made

    def dispatch(self, program: Program, groups: tuple[int, ...]) -> None:
        """Queue work groups of a program behind all that was queued before, whose writes they see."""
        self._bind_all(program)
        queue_compute(program.made, groups)
        self.context.memory_barrier()
        self.counts.dispatches += 1

    def draw(self, program: Program, vertices: int, size: tuple[int, int]) -> None:
        """Queue triangles without attributes for `size` pixels, with rows counted from below; else as `dispatch`."""
        self._bind_all(program)
        self._target = self._target or EmptyTarget()
        self._target.queue_draw(program.made, vertices, size)
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
        self._bound.clear()
        if self._target:
            self._target.release()
            self._target = None

    def _bind_all(self, program: Program) -> None:
        """Bind what a program declares, as far as its name stands for something; the rest is of no use to it."""
        for name, binding in program.blocks.items():
            made, size = self._bound.get(name, (None, 0))
            if made is None:
                continue
            if binding.kind == "texture":
                made.use(binding.number)
            elif binding.kind == "uniform":
                made.bind_to_uniform_block(binding.number, size=size)
            else:
                made.bind_to_storage_buffer(binding.number, size=size)

    def _at_least(self, name: str, size: int, *, keeps: bool = False) -> _Held:
        """Return the buffer of a name, made again if it is too small."""
        held = self._held.get(name)
        if held is None or held.made.size < size:
            made = self.context.buffer(reserve=max(LEAST_BYTES, size if held is None else int(GROWTH * size) + 3 & ~3))
            if self.context.error == "GL_OUT_OF_MEMORY":
                made.release()
                raise FullDeviceError(f"{self.context.info['GL_RENDERER']} has no memory for {size} more bytes")
            if held:
                if keeps:
                    self.context.copy_buffer(made, held.made, held.made.size)
                held.made.release()
            held = self._held[name] = _Held(made)
            self.counts.made += 1
        return held


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
