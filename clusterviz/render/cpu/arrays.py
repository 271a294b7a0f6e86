"""Arrays of a CPU by the names of the shaders' blocks, and machine code that threads run on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.render.abuffer.program import FindVariant
from clusterviz.render.render_result import Progress, no_progress
from clusterviz.render.variant import Variant
from clusterviz.spmd.machine_code import bound, compiled, texture_block
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.threads import run_threads

COUNTER = 1
"""Word of `progress` with the counter of tiles."""
Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Code:
    """Machine code of a variant, a function of the address of a table of addresses."""

    call: Callable[[int], None]
    variant: Variant | FindVariant
    source: ShaderSource

    def release(self) -> None:
        """Nothing is freed: the process keeps machine code."""


@cache
def compiled_variant(variant: Variant | FindVariant) -> Code:
    """Return the machine code of a variant of a CPU."""
    source = variant.source
    return Code(compiled(source, variant.name, variant.lanes), variant, source)


class CpuArrays:
    """Arrays by name; what shaders write is what was given."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._bound: dict[str, Array] = {}

    def give(self, name: str, data: Array) -> Array:
        """Hold data."""
        self._bound[name] = np.ascontiguousarray(data)
        return self._bound[name]

    begin = give

    def reserve(self, name: str, size: int, *, keeps: bool = False) -> Array:
        """Hold so many bytes, whose contents are undefined."""
        return self.give(name, np.empty(size, np.uint8))

    def table(self, name: str, texels: NDArray[np.float32]) -> Array:
        """Hold a texture, float32 (h, w, 4)."""
        return self.give(name, texture_block(texels.astype(np.float32)))

    def drop(self, name: str) -> None:
        """Hold an array no longer."""
        self._bound.pop(name, None)

    def write(self, buffer: Array, data: Array, offset: int = 0) -> None:
        """Write a part of an array."""
        _bytes(buffer)[offset : offset + data.nbytes] = _bytes(data)

    def clear(self, buffer: Array, size: int, offset: int = 0) -> None:
        """Fill a part of an array with zeros."""
        _bytes(buffer)[offset : offset + size] = 0

    def read(self, buffer: Array, size: int = -1, offset: int = 0) -> NDArray[np.uint8]:
        """Return bytes of an array, which are not copied."""
        return _bytes(buffer)[offset : offset + size if size >= 0 else None]

    def dispatch(self, program: Code, groups: tuple[int, ...]) -> None:
        """Let all threads take tiles, as many as work groups."""
        self.begin("progress", np.zeros(COUNTER + 1, np.uint32))
        self.run(program, int(np.prod(groups)), no_progress)

    def run(self, program: Code, tiles: int, progress: Progress) -> None:
        """Let all threads take tiles from the counter in `progress`; this one waits, so that it can be interrupted."""
        state = self._bound["progress"]

        def report() -> None:
            progress(min(1.0, int(state[COUNTER]) / tiles))

        table = bound(program.source, self._bound)
        self.call(program, table, state[COUNTER : COUNTER + 1], tiles, report)

    def call(self, program: Code, table: Array, counter: Array, tiles: int, report: Callable[[], None]) -> None:
        """Run machine code in all threads."""
        run_threads(program.call, table, counter, tiles, self._threads, report)

    def release(self) -> None:
        """Hold nothing."""
        self._bound = {}


def _bytes(data: Array) -> NDArray[np.uint8]:
    return data.reshape(-1).view(np.uint8)
