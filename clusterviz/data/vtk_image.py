"""Image data and rectilinear grids in VTK files: choice of an array, and its grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, UnnamedPartError
from clusterviz.data.header import check_shape, make_grid
from clusterviz.data.rectilinear import line_of, placed
from clusterviz.data.source import Grid, Source
from clusterviz.data.vtk_ghosts import ARRAYS, TYPE, visible
from clusterviz.errors import DataError


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
