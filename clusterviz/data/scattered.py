"""Scattered data: values at points, of stations or along wells, as a volume on a regular grid, or as a layer.

Each value belongs to the sample of the grid that is nearest to its point; several there are replaced by their mean. All
other samples are interpolated by `image.pyramid.interpolation`: smooth, within the range of the values, and the farther
from points the more like the mean around. So the volume is exact at the points but for half a voxel.

An axis along which the points have no extent, or that is to have one sample, makes a layer: two equal samples, since a
volume fills the box from its first to its last sample, so that it has a depth and is drawn.

Left out are points outside of the bounds, and those whose position or value is NaN, infinite or beyond 4e37.

The key `scattered` of a volume asks for it, of any file of meshes, lines, points or an unstructured grid. `array` names
the values; a file with a single array of one number for each point needs no name.

Limits: in memory, twelve bytes a sample while it is computed, on each rank that reads a box. Values are float32.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset
from clusterviz.data.geometry import Geometry
from clusterviz.data.header import check_box
from clusterviz.data.source import Grid, Index
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.errors import DataError

MOST_SAMPLES = 1 << 28
LARGEST = 4e37
LONGEST = 128
"""Samples along the longest side, unless others are asked for."""


@dataclass(frozen=True, eq=False)
class ScatteredSource:
    """Volume of values at points; see `Source`, and `scattered`, which makes it.

    Attributes
    ----------
    sides : samples along z, y, x that differ; 1 along the axis of a layer
    index : int64 (n,), number in C order of the sample of each point, of these
    values : float64 (n,)
    """

    name: str
    grid: Grid
    sides: Index
    index: NDArray[np.int64]
    values: NDArray[np.float64]

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(np.float32)

    @cached_property
    def voxels(self) -> NDArray[np.float32]:
        from clusterviz.image.pyramid.interpolation import interpolate  # slow to import

        shape = self.sides
        counts = np.bincount(self.index, minlength=prod(shape))
        sums = np.bincount(self.index, self.values, minlength=prod(shape))
        means = (sums / np.maximum(counts, 1)).astype(np.float32)
        found = interpolate(means.reshape(*shape, 1), (counts > 0).reshape(shape))[..., 0]
        return np.broadcast_to(found, self.grid.shape_zyx)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        return self.voxels[tuple(map(slice, begin_zyx, end_zyx))].copy()


def scattered(
    positions: NDArray[Any],
    values: NDArray[Any],
    size: int | Sequence[int] = LONGEST,
    bounds: Sequence[float] | None = None,
    name: str = "points",
) -> ScatteredSource:
    """Return values at points as a volume.

    Parameters
    ----------
    positions : (n, 3), or (n, 2) for a layer at z = 0; world
    size : samples along x, y, z, of which 1 projects the points on a layer; along x, y of a layer; or one number, along
        the longest side, and the others at about the same distance
    bounds : xmin, xmax, ymin, ymax(, zmin, zmax) of the first and last samples; default: those of the points.

    Raises
    ------
    DataError
        Wrong shapes, no points inside the bounds, or an impossible or too large grid.
    """
    places, numbers = np.asarray(positions, np.float64), np.asarray(values, np.float64)
    if places.ndim != 2 or places.shape[1] not in (2, 3) or numbers.shape != places.shape[:1]:
        found = f"{places.shape} and {numbers.shape}"
        raise DataError("wrong shapes of scattered data", where=name, found=found, allowed="(n, 2 or 3) and (n,)")
    axes = places.shape[1]
    box = np.asarray([-np.inf, np.inf] * axes if bounds is None else bounds, np.float64)
    if box.shape != (2 * axes,) or (bounds is not None and not np.isfinite(box).all()):
        allowed = "xmin, xmax, ymin, ymax and, with three axes, zmin, zmax"
        raise DataError("wrong bounds", where=name, found=bounds, allowed=allowed)
    box = box.reshape(axes, 2)
    with np.errstate(invalid="ignore"):
        is_inside = (places >= box[:, 0]) & (places <= box[:, 1]) & (np.abs(places) <= LARGEST)
    is_used = is_inside.all(axis=1) & (np.abs(numbers) <= LARGEST)
    if not is_used.any():
        found = f"{len(places)} points, of which {int(is_inside.all(axis=1).sum())} are inside"
        raise DataError("no points with a value", where=name, found=found, allowed="at least one inside the bounds")
    places, numbers = places[is_used], numbers[is_used]
    if bounds is None:
        box = np.stack([places.min(axis=0), places.max(axis=0)], axis=1)
    if axes == 2:
        places, box = np.pad(places, ((0, 0), (0, 1))), np.pad(box, ((0, 1), (0, 0)))
    sides, steps = _lattice(box[:, 1] - box[:, 0], size, name)
    nearest = np.rint((places - box[:, 0]) / steps).astype(np.int64)
    index = np.ravel_multi_index(tuple(np.minimum(nearest, np.array(sides) - 1).T[::-1]), sides[::-1])
    (nx, ny, nz), (dx, dy, dz), (x, y, z) = sides, steps.tolist(), box[:, 0].tolist()
    grid = Grid((max(2, nz), max(2, ny), max(2, nx)), (dx, dy, dz), (x, y, z))
    return ScatteredSource(name, grid, (nz, ny, nx), index, numbers)


def _lattice(lengths: NDArray[np.float64], size: int | Sequence[int], name: str) -> tuple[list[int], Any]:
    given = [size] if isinstance(size, int | np.integer) else [*size]
    if len(given) not in (1, 2, 3) or not all(isinstance(n, int | np.integer) and n >= 1 for n in given):
        raise DataError("wrong size of the grid", where=name, found=size, allowed="samples along x, y, z, at least 1")
    if len(given) == 1:
        step = lengths.max() / max(1, given[0] - 1)
        sides = [1 if length == 0 else max(2, round(length / step) + 1) for length in lengths.tolist()]
    else:
        sides = [1 if length == 0 else n for n, length in zip([*given, 1], lengths.tolist(), strict=False)]
    if prod(sides) > MOST_SAMPLES:
        found = " × ".join(map(str, sides))
        raise DataError(
            "too large a grid of scattered data", where=name, found=found, allowed=f"{MOST_SAMPLES} samples"
        )
    steps = lengths / np.maximum(np.array(sides) - 1, 1)
    return sides, np.where(steps > 0, steps, steps.min(where=steps > 0, initial=np.inf) if lengths.any() else 1.0)


def open_scattered(path: Path, subset: Subset, content: Geometry | UnstructuredGrid) -> ScatteredSource:
    """Open the points of a file that was read whole."""
    assert subset.scattered is not None
    positions, arrays = _points(content)
    numbers = {name: array.reshape(-1) for name, array in arrays.items() if array.size == len(array)}
    numbers = {name: array for name, array in numbers.items() if array.dtype.kind in "iufb"}
    listed = ", ".join(numbers) or "none: the file has no array with one number a point"
    name = subset.array or (next(iter(numbers)) if len(numbers) == 1 else "")
    if name not in numbers:
        what = "no such array" if subset.array or not numbers else "several arrays: name one"
        raise DataError(what, where=str(path), found=subset.array, allowed=listed)
    where = f"{path}:{name}" if len(numbers) > 1 else str(path)
    return scattered(positions, numbers[name], subset.scattered.size, subset.scattered.bounds, where)


def _points(content: Geometry | UnstructuredGrid) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    if isinstance(content, UnstructuredGrid):
        return content.points, dict(content.point_arrays)
    parts = [(part.positions, part.attributes) for part in (content.points,) if part]
    parts += [(part.points, part.point_attributes) for part in (content.lines,) if part]
    parts += [(part.vertices, part.vertex_attributes) for part in (content.mesh,) if part]
    positions, arrays = max(parts, key=lambda part: len(part[0]), default=(np.empty((0, 3)), {}))
    return positions, dict(arrays)
