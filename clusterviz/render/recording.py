"""Dispatches of a draw, recorded without OpenGL, and run on OpenGL again with another shader.

The ray caster draws on a context that keeps buffers as NumPy arrays. At each dispatch it stops and hands over the
shader and all that is bound, so that a debugger or a profiler executes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.compute import run_compute
from clusterviz.gl.driver_needs import compile_checked
from clusterviz.gl.reals import EXTENSION
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.crossing import Crossing
from clusterviz.render.opengl import opengl_caster
from clusterviz.spmd.interpreter import Dispatch, Texture
from clusterviz.spmd.parser import parse
from clusterviz.spmd.source import ShaderSource

Index = tuple[int, int, int]
Bytes = NDArray[np.uint8]
LIMITS = {
    "GL_RENDERER": "recording",
    "GL_MAX_UNIFORM_BLOCK_SIZE": 1 << 16,
    "GL_MAX_SHADER_STORAGE_BLOCK_SIZE": (1 << 31) - 1,
    "GL_MAX_3D_TEXTURE_SIZE": 2048,
}
EMPTY = bytes(16)
"""OpenGL has no buffers without bytes."""
TEXELS = {"f1": ("u1", 255.0), "nu2": ("<u2", 65535.0), "f4": ("<f4", 1.0)}
"""By moderngl's name of a type of texels NumPy's, and the divisor that makes them 0 … 1."""


def recorded(
    plan: Plan,
    bricks: MutableMapping[Index, Any],
    pieces: Iterable[Piece],
    crossings: Sequence[Crossing] = (),
) -> Iterator[Dispatch]:
    """Yield the dispatches that draw pieces, one after the other.

    Each has to be executed on its own arrays before the next is asked for, as that depends on its outcome.

    Parameters
    ----------
    plan : of the frame
    bricks : by index, as for `Caster.load`; they are removed from the mapping
    crossings : `carried` of `Caster.draw`
    """
    context: Any = _Context()
    caster = opengl_caster(context, plan, band_pixels=1 << 62)
    caster.load(plan, bricks)
    pieces = tuple(pieces)
    while True:
        context.number = 0
        caster.forget()
        try:
            caster.draw(plan, pieces, carried=crossings)
        except _Reached as reached:
            source = reached.dispatch.source
            written = {each.binding for each in parse(source).blocks if not each.is_read_only}
            buffers = {n: data.copy() if n in written else data for n, data in reached.dispatch.buffers.items()}
            yield replace(reached.dispatch, buffers=buffers)
            context.outcomes.append({n: data for n, data in buffers.items() if n in written})
        else:
            return


def run_on(context: moderngl.Context, dispatch: Dispatch, binding: int, size: int) -> Bytes:
    """Execute a dispatch on OpenGL with a further buffer of zeros, and return what that holds afterwards.

    The dispatch's own buffers change as it says.

    Parameters
    ----------
    binding, size : of the further buffer, in bytes
    """
    program, further = compile_checked(context, dispatch.source), context.buffer(reserve=size or len(EMPTY))
    made, buffers = list[Any]([program, further]), dict[int, moderngl.Buffer]()
    further.clear()
    further.bind_to_storage_buffer(binding)
    for number, data in dispatch.uniforms.items():
        made.append(context.buffer(data.tobytes() or EMPTY))
        made[-1].bind_to_uniform_block(number)
    for number, data in dispatch.buffers.items():
        buffers[number] = context.buffer(data.tobytes() or EMPTY)
        buffers[number].bind_to_storage_buffer(number)
    for number, texture in dispatch.textures.items():
        made.append(_made(context, texture))
        made[-1].use(number)
    run_compute(program, dispatch.groups)
    context.memory_barrier()
    found = np.frombuffer(further.read(), np.uint8)[:size]
    for number, buffer in buffers.items():
        size = dispatch.buffers[number].nbytes
        dispatch.buffers[number][:] = np.frombuffer(buffer.read(), np.uint8)[:size]
    for one in (*made, *buffers.values()):
        one.release()
    return found


def _made(context: moderngl.Context, texture: Texture) -> moderngl.Texture | moderngl.Texture3D:
    *sizes, components = texture.texels.shape
    stored, divisor = TEXELS[texture.stored]
    texels = (texture.texels * np.float32(divisor)).round() if divisor > 1 else texture.texels
    make: Any = context.texture3d if len(sizes) == 3 else context.texture
    made = make(tuple(sizes[::-1]), components, texels.astype(stored).tobytes(), alignment=1, dtype=texture.stored)
    made.filter = (moderngl.LINEAR if texture.linear else moderngl.NEAREST,) * 2
    for axis in "xyz"[: len(sizes)]:
        setattr(made, f"repeat_{axis}", False)
    return made  # type: ignore[no-any-return]


class _Reached(Exception):  # noqa: N818
    """The draw has come to a dispatch that has not been executed."""

    def __init__(self, dispatch: Dispatch) -> None:
        self.dispatch = dispatch


class _Context:
    """What the ray caster uses of a context; a dispatch that was executed before has its outcome again."""

    info, error, extensions = LIMITS, "GL_NO_ERROR", frozenset({EXTENSION})

    def __init__(self) -> None:
        self.number, self.outcomes = 0, list[Mapping[int, Bytes]]()
        self.uniforms, self.buffers = dict[int, _Buffer](), dict[int, _Buffer]()
        self.textures = dict[int, _Texture]()

    def buffer(self, data: bytes = b"", reserve: int = 0) -> _Buffer:
        return _Buffer(self, np.frombuffer(data, np.uint8).copy() if data else np.zeros(reserve, np.uint8))

    def texture(self, size: tuple[int, ...], components: int, data: bytes = b"", **options: Any) -> _Texture:
        return _Texture(self, size, components, data, options["dtype"])

    texture3d = texture

    def compiled(self, source: ShaderSource) -> _Program:
        return _Program(self, source)

    def run(self, source: ShaderSource, groups: tuple[int, int, int]) -> None:
        if self.number == len(self.outcomes):
            buffers = {n: each.data for n, each in self.buffers.items()}
            uniforms = {n: each.data for n, each in self.uniforms.items()}
            textures = {n: each.contents for n, each in self.textures.items()}
            raise _Reached(Dispatch(source, groups, uniforms, buffers, textures))
        for number, data in self.outcomes[self.number].items():
            self.buffers[number].data[: len(data)] = data  # buffers may have grown since
        self.number += 1

    def copy_buffer(self, to: _Buffer, source: _Buffer, size: int) -> None:
        to.data[:size] = source.data[:size]

    def memory_barrier(self) -> None:
        """A dispatch is over when it returns."""

    def release(self) -> None:
        """Nothing is held."""


@dataclass(frozen=True)
class _Program:
    context: _Context
    source: ShaderSource

    def run(self, x: int, y: int = 1, z: int = 1) -> None:
        self.context.run(self.source, (x, y, z))

    def release(self) -> None:
        """Nothing is held."""


class _Buffer(moderngl.Buffer):
    def __init__(self, context: _Context, data: Bytes) -> None:
        self._context, self.data = context, data

    def __del__(self) -> None:
        """Nothing is held."""

    @property
    def size(self) -> int:  # type: ignore[override]
        return self.data.size

    def write(self, data: Any, offset: int = 0) -> None:
        given = np.frombuffer(np.ascontiguousarray(data) if isinstance(data, np.ndarray) else data, np.uint8)
        self.data[offset : offset + len(given)] = given

    def read(self, size: int = -1, offset: int = 0) -> bytes:
        return self.data[offset : offset + size if size >= 0 else None].tobytes()

    def bind_to_uniform_block(self, binding: int = 0, offset: int = 0, size: int = -1) -> None:
        self._context.uniforms[binding] = self

    def bind_to_storage_buffer(self, binding: int = 0, offset: int = 0, size: int = -1) -> None:
        self._context.buffers[binding] = self

    def release(self) -> None:
        """Nothing is held."""


class _Texture(moderngl.Texture3D):
    filter: Any = (moderngl.LINEAR, moderngl.LINEAR)
    repeat_x = repeat_y = repeat_z = True

    def __init__(self, context: _Context, size: tuple[int, ...], components: int, data: bytes, dtype: str) -> None:
        self._context, self._stored = context, dtype
        self._size = (*size, 1)[:3]
        self._texels = np.zeros((*size[::-1], components), TEXELS[dtype][0])
        if data:
            self._texels.reshape(-1)[:] = np.frombuffer(data, self._texels.dtype)

    def __del__(self) -> None:
        """Nothing is held."""

    def write(self, data: Any, viewport: Any = None, alignment: int = 1) -> None:
        part = np.frombuffer(data if isinstance(data, bytes) else np.ascontiguousarray(data), self._texels.dtype)
        if viewport is None:
            self._texels.reshape(-1)[:] = part
            return
        x, y, z, width, height, depth = viewport
        part = part.reshape(depth, height, width, -1)
        self._texels[z : z + depth, y : y + height, x : x + width] = part

    @property
    def contents(self) -> Texture:
        texels = self._texels.astype(np.float32) / np.float32(TEXELS[self._stored][1])
        return Texture(texels, self.filter[0] == moderngl.LINEAR, self._stored)

    def use(self, location: int = 0) -> None:
        self._context.textures[location] = self

    def release(self) -> None:
        """Nothing is held."""
