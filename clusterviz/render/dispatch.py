"""Buffers of a draw, and the dispatches that march rays through boxes of bricks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.compute import run_compute
from clusterviz.render.frame_block import ASK


class Buffers:
    """Buffers and textures that live for one draw or one piece."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._made: list[moderngl.Buffer | moderngl.Texture] = []

    def bind(self, binding: int, data: NDArray[Any]) -> moderngl.Buffer:
        buffer = self.make(data)
        buffer.bind_to_storage_buffer(binding)
        return buffer

    def reserve(self, binding: int, size: int) -> moderngl.Buffer:
        buffer = self._context.buffer(reserve=size)
        buffer.bind_to_storage_buffer(binding)
        self._made.append(buffer)
        return buffer

    def make(self, data: NDArray[Any]) -> moderngl.Buffer:
        buffer = self._context.buffer(data.tobytes())
        self._made.append(buffer)
        return buffer

    def table(self, texels: NDArray[np.float32]) -> moderngl.Texture:
        """Return a texture of float32 (h, w, 4)."""
        texture = self._context.texture(texels.shape[1::-1], 4, texels.tobytes(), dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._made.append(texture)
        return texture

    def __enter__(self) -> Buffers:
        return self

    def __exit__(self, *_: object) -> None:
        for buffer in self._made:
            buffer.release()


@dataclass(frozen=True)
class March:
    """Dispatches for the pixels of a piece.

    Attributes
    ----------
    context, program, buffers : those of the caster
    progress : buffer with the progress of each pixel, bound
    groups : number of work groups in x and y
    """

    context: moderngl.Context
    program: moderngl.ComputeShader
    buffers: Buffers
    progress: moderngl.Buffer
    groups: tuple[int, int]

    def through(self, block: NDArray[np.void]) -> None:
        """Dispatch until all rays are done; rays of more than some thousand slabs take several dispatches."""
        block["first_dispatch"] = 1
        while self._dispatch(block):
            block["first_dispatch"] = 0

    def reaches(self, block: NDArray[np.void]) -> bool:
        """Return True if any ray that meets the block's box has not ended in front of it."""
        block["first_dispatch"] = ASK
        return self._dispatch(block)

    def _dispatch(self, block: NDArray[np.void]) -> bool:
        """Run the program once; return True if a ray is not done."""
        self.buffers.make(block).bind_to_uniform_block(0)
        self.progress.write(b"\0\0\0\0")
        run_compute(self.program, self.groups)
        self.context.memory_barrier()
        return bool(np.frombuffer(self.progress.read(4), np.uint32)[0])
