"""Ghost arrays of VTK's files: points and cells that are not drawn.

`vtkGhostType` holds bits for each point or cell: another piece has it, a finer grid covers it, or it is hidden. As in
VTK, cells with one of these are left out, and so are cells with a hidden point. Samples of an image that are hidden are
NaN. `vtkGhostLevels` of old files is positive where another piece has the point or cell.

References
----------
VTK 9, vtkDataSetAttributes: CellGhostTypes, PointGhostTypes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import DerivedSource
from clusterviz.data.geometry import Attributes
from clusterviz.data.source import Grid, Index, Source, as_index

TYPE, LEVELS = "vtkGhostType", "vtkGhostLevels"
ARRAYS = (TYPE, LEVELS)
"""Names of arrays that hold no data."""
DUPLICATE, HIDDEN_POINT, REFINED, HIDDEN_CELL = 1, 2, 8, 32
UNDRAWN_POINTS, UNDRAWN_CELLS = DUPLICATE | HIDDEN_POINT, DUPLICATE | REFINED | HIDDEN_CELL
"""Bits of points that are drawn as such, and of cells."""
HIDDEN = HIDDEN_POINT, REFINED | HIDDEN_CELL
"""Bits of the points and of the cells of an image that are NaN."""


def split_ghosts(arrays: Attributes, count: int) -> tuple[Attributes, NDArray[np.uint8]]:
    """Return the arrays of `count` points or cells that hold data, and the bits of each, uint8 (count,)."""
    bits = np.zeros(count, np.uint8)
    for name in ARRAYS:
        if name in arrays:
            stated = np.asarray(arrays[name]).reshape(count, -1 if count else 1)[:, 0]
            bits |= stated.astype(np.uint8) if name == TYPE else (stated > 0).astype(np.uint8)
    return {name: array for name, array in arrays.items() if name not in ARRAYS}, bits


def drawn_cells(
    offsets: NDArray[np.int64], corners: NDArray[np.int64], bits: NDArray[np.uint8], of_points: NDArray[np.uint8]
) -> NDArray[np.bool_]:
    """Return which cells are drawn, bool (m,).

    Parameters
    ----------
    offsets : int64 (m + 1,); cell i has the points corners[offsets[i]:offsets[i + 1]]
    bits, of_points : of cells (m,) and of points
    """
    is_drawn: NDArray[np.bool_] = bits & UNDRAWN_CELLS == 0
    if (of_points & HIDDEN_POINT).any():
        hidden = np.append(0, np.cumsum(of_points.take(corners, mode="clip") & HIDDEN_POINT != 0))
        is_drawn &= hidden[offsets[1:]] == hidden[offsets[:-1]]
    return is_drawn


def some_cells(
    offsets: NDArray[np.int64], corners: NDArray[np.int64], is_kept: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return offsets and points of some of the cells."""
    lengths = np.diff(offsets)
    inside = corners[offsets[0] : offsets[-1]]
    return np.append(0, np.cumsum(lengths[is_kept])), inside[np.repeat(is_kept, lengths)]


@dataclass(frozen=True)
class GhostBits:
    """Bits of an image's points or cells, which decide over its samples.

    Attributes
    ----------
    mask : bits that count
    before, after : a sample takes those of so many places before and behind it along each axis: of points, if samples
        are cells, and the reverse
    """

    source: Source
    mask: int
    before: int = 0
    after: int = 0

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[np.bool_]:
        """Return which samples of a box have one of the bits."""
        begin, end = np.array(begin_zyx) - self.before, np.array(end_zyx) + self.after
        first, last = np.maximum(begin, 0), np.minimum(end, self.source.grid.shape_zyx)
        around = np.zeros(end - begin, bool)
        low, high = first.tolist(), np.maximum(first, last).tolist()
        bits = self.source.read(as_index(low), as_index(high))
        inside = tuple(slice(a - b, c - b) for a, b, c in zip(low, begin.tolist(), high, strict=True))
        around[inside] = bits.astype(np.uint8) & self.mask != 0
        found = np.zeros(np.array(end_zyx) - begin_zyx, bool)
        for shift in product(range(self.before + self.after + 1), repeat=3):
            found |= around[tuple(slice(s, s + n) for s, n in zip(shift, found.shape, strict=True))]
        return found


@dataclass(frozen=True)
class VisibleSource(DerivedSource):
    """Image whose hidden samples are NaN.

    Attributes
    ----------
    hidden : what hides a sample
    duplicates : where another piece has the sample
    """

    grid: Grid
    hidden: tuple[GhostBits, ...]
    duplicates: tuple[GhostBits, ...] = ()

    @property
    def stored_dtype(self) -> np.dtype[Any]:
        found: np.dtype[Any] = self.source.stored_dtype
        return found

    @property
    def dtype(self) -> np.dtype[Any]:
        """Float32, or float64 if float32 cannot hold the stored type."""
        found: np.dtype[Any] = np.result_type(self.source.dtype, np.float32)
        return found

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        samples: NDArray[Any] = self.source.read(begin_zyx, end_zyx).astype(self.dtype)
        for each in self.hidden:
            samples[each.read(begin_zyx, end_zyx)] = np.nan
        return samples


def visible(source: Any, on_cells: bool, ghosts: Sequence[tuple[bool, Source]]) -> Any:
    """Return an image without its hidden samples: the source itself if there are no ghost arrays.

    Samples of points at the corners of hidden cells are hidden, so cells beside these are not drawn either.

    Parameters
    ----------
    on_cells : whether samples are those of cells
    ghosts : of each ghost array whether it belongs to cells, and its samples
    """
    if not ghosts:
        return source
    hidden = [
        GhostBits(bits, HIDDEN[of_cells], int(of_cells and not on_cells), int(on_cells and not of_cells))
        for of_cells, bits in ghosts
    ]
    duplicates = [GhostBits(bits, DUPLICATE) for of_cells, bits in ghosts if of_cells == on_cells]
    return VisibleSource(source, source.grid, tuple(hidden), tuple(duplicates))
