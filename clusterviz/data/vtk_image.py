"""Image data and rectilinear grids in VTK files: choice of an array, its grid, and ghosts, also of points and cells.

`vtkGhostType` holds bits for each point or cell: another piece has it, a finer grid covers it, or it is hidden. As in
VTK, cells with one of these are left out, and so are cells with a hidden point. Samples of an image that are hidden are
NaN. `vtkGhostLevels` of old files is positive where another piece has the point or cell.

References
----------
VTK 9, vtkDataSetAttributes: CellGhostTypes, PointGhostTypes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, UnnamedPartError
from clusterviz.data.derived import DerivedSource
from clusterviz.data.geometry import Attributes
from clusterviz.data.header import check_shape, make_grid, stated_numbers
from clusterviz.data.rectilinear import line_of, placed
from clusterviz.data.source import Grid, Index, Source, as_index
from clusterviz.errors import DataError

TYPE, LEVELS = "vtkGhostType", "vtkGhostLevels"
ARRAYS = (TYPE, LEVELS)
"""Names of arrays that hold no data."""
DUPLICATE, HIDDEN_POINT, REFINED, HIDDEN_CELL = 1, 2, 8, 32
UNDRAWN_POINTS, UNDRAWN_CELLS = DUPLICATE | HIDDEN_POINT, DUPLICATE | REFINED | HIDDEN_CELL
"""Bits of points that are drawn as such, and of cells."""
HIDDEN = HIDDEN_POINT, REFINED | HIDDEN_CELL
"""Bits of the points and of the cells of an image that are NaN."""


@dataclass(frozen=True)
class ImageArray:
    """Array of an image; `active`: the file marks it as the active scalars, `held`: the numbers of some formats."""

    name: str
    on_cells: bool
    active: bool
    components: int
    held: Any = None


Array = TypeVar("Array", bound=ImageArray)


def open_image(
    arrays: Sequence[Array], subset: Subset, path: Path, noun: str, source_of: Callable[[Array, Subset], Any]
) -> tuple[Array, Any]:
    """Return the array that a subset names, see `choose_array`, and its samples without those that ghosts hide.

    Parameters
    ----------
    arrays : of the file; with `subset.vectors` those of three components are vectors
    source_of : returns the samples of an array
    """
    fitting = [array for array in arrays if array.components == 3] if subset.vectors else arrays
    chosen = choose_array(fitting, subset.array, "array of vectors" if subset.vectors else noun, path)
    ghosts = [
        (array.on_cells, source_of(array, Subset(time=subset.time)))
        for array in arrays
        if array.name == TYPE and array is not chosen and array.components == 1
    ]
    return chosen, visible(source_of(chosen, subset), chosen.on_cells, ghosts)


def choose_array(arrays: Sequence[Array], name: str | None, noun: str, path: Path) -> Array:
    """Return the named array; without a name the active scalars, point data first, or the only array."""
    arrays = [a for a in arrays if a.name not in ARRAYS] if name is None else arrays
    listed = ", ".join(f"{a.name} ({'cells' if a.on_cells else 'points'})" for a in arrays) or f"none: no {noun}"
    if name is not None:
        named = [a for a in arrays if a.name == name]
        if not named:
            raise DataError(f"no such {noun}", where=str(path), found=name, allowed=listed)
        return named[0]
    active = [a for a in arrays if a.active]
    if active:
        return min(active, key=lambda a: a.on_cells)
    if not arrays:
        raise DataError("no scalar volume", where=str(path), allowed=listed)
    own = [a for a in arrays if not a.name.startswith("vtk")] or arrays  # before VTK's numbers and flags
    if len(own) > 1:
        raise UnnamedPartError("array", [a.name for a in own], where=str(path), allowed=listed)
    return own[0]


def image_grid(
    points: NDArray[np.int64] | NDArray[np.float64],
    steps: NDArray[np.float64],
    origin: NDArray[np.float64],
    first: NDArray[np.float64],
    on_cells: bool,
    where: str,
) -> Grid:
    """Return the grid of point data, or of cell data as point data at the cells' centres.

    Parameters
    ----------
    points : (3,), points along x, y, z
    steps : float64 (3, 3), column a is the world vector between neighbours along axis a
    origin : float64 (3,), world position of index 0
    first : float64 (3,), index of the first point along x, y, z
    """
    samples = points
    if on_cells:
        samples = np.where(points > 1, points - 1, points)
        first = first + np.where(points > 1, 0.5, 0.0)
    return make_grid(check_shape(samples[::-1].tolist(), where), steps, origin + steps @ first, where)


def stated_grid(stated: Mapping[str, Any], extent: NDArray[np.int64], on_cells: bool, where: str) -> Grid:
    """Return the grid of an image by its Origin, Spacing and Direction, text or numbers; index 0 lies at the origin.

    Parameters
    ----------
    extent : int64 (3, 2), first and last index of the points along x, y, z
    """
    direction = stated_numbers(stated.get("Direction", np.eye(3)), "Direction", 9, where)
    steps = direction.reshape(3, 3) * stated_numbers(stated.get("Spacing", np.ones(3)), "Spacing", 3, where)
    origin = stated_numbers(stated.get("Origin", np.zeros(3)), "Origin", 3, where)
    return image_grid(extent[:, 1] - extent[:, 0] + 1, steps, origin, extent[:, 0].astype(float), on_cells, where)


def rectilinear(
    source: Any, coordinates_xyz: Sequence[NDArray[Any]], on_cells: bool, spaced: bool, where: str
) -> Source:
    """Return a volume at the coordinates of points, or between them if it is cell data; see `rectilinear.placed`.

    Parameters
    ----------
    source : the stored samples, a source that is a dataclass with a field `grid`
    """
    lines = []
    for coordinates, name in zip(coordinates_xyz, "xyz", strict=True):
        places = np.asarray(coordinates)
        if on_cells and len(places) > 1:
            middles = (places[1:].astype(float) + places[:-1]) / 2
            places = middles.astype(places.dtype) if places.dtype.kind == "f" else middles
        lines.append(line_of(places, spaced, name, where))
    found: Source = placed(source, lines, np.eye(3), spaced)
    return found


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
