"""Fragments of a rectangle of pixels, ready to be drawn, and what the ways of finding them share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import DeviceError
from clusterviz.plan.plan import Plan
from clusterviz.render.abuffer.primitives import PrimitiveTable
from clusterviz.render.abuffer.program import MOST_SORTED, lit_layer
from clusterviz.render.abuffer.resolves import DRAWN_CLASS
from clusterviz.render.cells.table import grids_block

DRAW_ITERATIONS = 16
"""Bound for a fragment of a pixel; each layer adds one."""
Read = Sequence[NDArray[np.uint8]]


@dataclass(frozen=True)
class Fragments:
    """Lists of fragments, and what their counts are read from when they are drawn.

    Attributes
    ----------
    lists : the buffer of the lists; for a k-buffer, of the counts of pixels
    sizes : of the programs that draw them, of one class of tiles each
    beside : parts of buffers that `counts` and `are_all` want: buffer, first byte, number of bytes
    counts : returns fragments of pixels, int32 (pixels,), of what was read
    are_all : returns whether there was room for all; if not, there is now
    """

    lists: Any
    sizes: Sequence[int]
    beside: Sequence[tuple[Any, int, int]]
    counts: Callable[[Read], NDArray[np.int32]]
    are_all: Callable[[Read], bool] = lambda _: True

    def choose(self, arrays: Any, size: int) -> None:
        """Choose the class of tiles that is drawn next."""
        arrays.write(self.lists, np.array([size], np.uint32), 4 * DRAWN_CLASS)


def give_scene(arrays: Any, plan: Plan, table: PrimitiveTable, block: NDArray[np.void], most_bytes: int) -> None:
    """Give what all primitives share, the lights, and the tetrahedra of a table.

    Raises
    ------
    DeviceError
        There are more tetrahedra than a buffer of `most_bytes` holds; 0: any number.
    """
    arrays.give("geometry", block)
    if shading := lit_layer(plan):
        arrays.give("lights", shading.block())
    if not table.cells:
        return
    found = table.cells.words.nbytes
    if most_bytes and found > most_bytes:
        raise DeviceError(
            f"too large a buffer for {table.cells.tetrahedra} tetrahedra; found {found} bytes; allowed {most_bytes}; "
            "more ranks have fewer each, and CPUs draw any number (--device cpu)"
        )
    arrays.give("grid", grids_block(plan.content, table.cells))
    arrays.give("cells", table.cells.words)


def check_loops(limit: int, found: int, iterations: int, of: str) -> None:
    """Refuse what a device with a limit of iterations would not draw to the end."""
    if limit and found * iterations > limit:
        allowed = f"{limit // iterations}; CPUs draw any number (--device cpu)"
        raise DeviceError(f"too many {of} for llvmpipe; found {found}; allowed {allowed}")


def sort_long(arrays: Any, keys: Any, counts: NDArray[np.uint32], begins: NDArray[np.uint32]) -> None:
    """Sort the fragments of pixels with more than `MOST_SORTED`."""
    for pixel in np.flatnonzero(counts > MOST_SORTED):
        size, offset = 8 * int(counts[pixel]), 8 * int(begins[pixel])
        own = np.frombuffer(arrays.read(keys, size, offset), np.uint32).reshape(-1, 2)
        arrays.write(keys, own[np.lexsort(own.T[::-1])], offset)
