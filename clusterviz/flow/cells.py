"""Vectors on unstructured grids: in tetrahedra, with what finds the one that holds a place.

Cells are cut into tetrahedra as for drawing. Vectors of points are linear in each, vectors of cells constant. A place
is found by neighbours across faces, and by a grid of bins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data import read_grid
from clusterviz.data.axes import UnnamedPartError
from clusterviz.data.faces import NONE, find_neighbours
from clusterviz.data.source import Grid
from clusterviz.data.tetrahedra import make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vectors import KNOWN_NAMES, VectorArray, check_components, world_from_index
from clusterviz.errors import DataError

BINS_PER_CELL = 0.5
_CHUNK = 1 << 16
_INSIDE = 1e-9


@dataclass(frozen=True)
class Cells:
    """Vectors in tetrahedra.

    Attributes
    ----------
    places : float64 (3 · n,), points, world
    corners : int64 (4 · m,), points of each tetrahedron
    neighbours : int64 (4 · m,), the tetrahedron behind the face without each of these points; -1: none
    vectors : float32 (4 · k,), of points or of tetrahedra, and a zero
    on_cells : whether they are those of tetrahedra
    low, sides : float64 (3,), corner and side of the bins, world
    bins : number of bins along x, y, z
    begins : int64 (bins + 1,), of each bin's tetrahedra in `members`
    members : int64, the tetrahedra whose boxes meet each bin
    size : world length of a mean edge of a tetrahedron, in which steps are given
    name : for messages
    """

    places: NDArray[np.float64]
    corners: NDArray[np.int64]
    neighbours: NDArray[np.int64]
    vectors: NDArray[np.float32]
    on_cells: bool
    low: NDArray[np.float64]
    sides: NDArray[np.float64]
    bins: tuple[int, ...]
    begins: NDArray[np.int64]
    members: NDArray[np.int64]
    size: float
    name: str = "tetrahedra"


def open_cells(
    path: str | Path, array: str | None = None, time: float | None = None, order: str = "xyz", scale: float = 1.0
) -> Cells:
    """Read the vectors of an unstructured grid; parameters as of `open_vectors`, but `time` may be that of the step.

    Raises
    ------
    DataError
        As `read_grid`, no such array, the array holds no vectors, or no cell has a volume.
    """
    check_components(str(path), order, scale)
    grid = read_grid(path, time)
    vectors, on_cells, name = _vectors_of(grid, array)
    placed = UnstructuredGrid(grid.name, grid.points, grid.cells, {"none": np.zeros(len(grid.points), np.float32)})
    tetrahedra = make_tetrahedra(placed)
    if not len(tetrahedra.corners):
        raise DataError("no cell has a volume", where=grid.name, found=f"{grid.count} cells")
    chosen = vectors[tetrahedra.cells if on_cells else tetrahedra.rows][:, [order.index(axis) for axis in "xyz"]]
    made = make_cells(tetrahedra.points, tetrahedra.corners, scale * chosen.astype(np.float64), on_cells)
    return replace(made, name=f"{path}:{name}")


def _vectors_of(grid: UnstructuredGrid, name: str | None) -> tuple[NDArray[Any], bool, str]:
    """Return vectors (n, 3), whether they belong to cells, and their name."""
    sets = ((grid.point_arrays, False), (grid.cell_arrays, True))
    found = {
        key: (array, on_cells) for arrays, on_cells in reversed(sets) for key, array in arrays.items()
    }  # the points' if both have one
    three = [key for key, (array, _) in found.items() if array.ndim == 2 and array.shape[1] == 3]
    known = [key for key in KNOWN_NAMES if set(key.split(",")) <= set(found)]
    name = name or (three[0] if len(three) == 1 else known[0] if known and not three else None)
    allowed = ", ".join([*three, *known]) or f"array: u,v,w of {', '.join(found)}"
    if name is None and three:
        raise UnnamedPartError("array", three, where=grid.name, found=", ".join(three), allowed=allowed)
    if name is None:
        raise DataError("no vectors", where=grid.name, found=", ".join(found) or "no array", allowed=allowed)
    names = [key.strip() for key in name.split(",")]
    lost = [key for key in names if key not in found]
    if lost:
        raise DataError("no such array of vectors", where=grid.name, found=lost[0], allowed=allowed)
    if len(names) == 1 and names[0] in three:
        return *found[names[0]], name
    parts = [found[key] for key in names]
    shapes = {(array.reshape(len(array), -1).shape, on_cells) for array, on_cells in parts}
    if len(names) != 3 or len(shapes) != 1 or parts[0][0].size != len(parts[0][0]):
        raise DataError("not vectors", where=grid.name, found=f"{name} {parts[0][0].shape}", allowed=allowed)
    return np.stack([array.reshape(-1) for array, _ in parts], axis=1), parts[0][1], name


def regular_vectors(cells: Cells, size: int = 64) -> VectorArray:
    """Sample vectors of tetrahedra on a regular grid over their box; NaN outside of them.

    Parameters
    ----------
    size : samples along the longest side, 2 or more
    """
    extent = cells.sides * np.array(cells.bins)
    spacing = float(extent.max()) / (size - 1)
    shape = np.floor(extent / spacing * (1 + 1e-9)).astype(int) + 1
    grid = Grid(tuple(shape[::-1].tolist()), (spacing,) * 3, tuple(cells.low.tolist()))
    found = np.full((*grid.shape_zyx, 3), np.nan, np.float32)
    flat, tetrahedra = found.reshape(-1, 3), cells.corners.reshape(-1, 4)
    places, vectors = cells.places.reshape(-1, 3), cells.vectors.reshape(-1, 4)[:, :3].astype(np.float64)
    for begin in range(0, len(tetrahedra), _CHUNK):
        # The samples in the box around each tetrahedron.
        corners = tetrahedra[begin : begin + _CHUNK]
        boxes = (places[corners] - cells.low) / spacing
        first = np.clip(np.ceil(boxes.min(axis=1) - _INSIDE), 0, shape).astype(np.int64)
        end = np.clip(np.floor(boxes.max(axis=1) + _INSIDE) + 1, first, shape).astype(np.int64)
        owner, at = _lattice(first, end)
        # Those inside it, by their barycentric coordinates.
        origin = places[corners[:, 0]]
        inverse = np.linalg.inv((places[corners[:, 1:]] - origin[:, None]).transpose(0, 2, 1))
        rest = np.einsum("nij,nj->ni", inverse[owner], world_from_index(at, grid) - origin[owner])
        weights = np.column_stack([1 - rest.sum(axis=1), rest])
        inside = (weights >= -_INSIDE).all(axis=1)
        owner, at, weights = owner[inside], at[inside], weights[inside]
        rows = (at[:, 2] * shape[1] + at[:, 1]) * shape[0] + at[:, 0]
        if cells.on_cells:
            flat[rows] = vectors[begin + owner]
        else:
            flat[rows] = np.einsum("nc,ncj->nj", weights, vectors[corners[owner]])
    return VectorArray(found, grid, name=cells.name)


def _lattice(first: NDArray[np.int64], end: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the places x, y, z of lattices from `first` (n, 3) to `end`, int64 (m, 3), and the lattice of each."""
    span = end - first
    counts = span.prod(axis=1)
    owner = np.repeat(np.arange(len(first)), counts)
    within, sides = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts), span[owner]
    steps = (within % sides[:, 0], within // sides[:, 0] % sides[:, 1], within // (sides[:, 0] * sides[:, 1]))
    return owner, first[owner] + np.stack(steps, axis=1)


def make_cells(points: NDArray[Any], corners: NDArray[Any], vectors: NDArray[Any], on_cells: bool) -> Cells:
    """Return vectors in tetrahedra with their neighbours and bins.

    Parameters
    ----------
    points : (n, 3), world
    corners : int (m, 4), rows of `points`, in the order of `Tetrahedra.corners`; each tetrahedron has a volume
    vectors : (n, 3) of points, or (m, 3) of tetrahedra
    """
    places, tetrahedra = points.astype(np.float64), corners.astype(np.int64)
    boxes = places[tetrahedra]
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    begin, end = low.min(axis=0), high.max(axis=0)
    # Bins of a size of which a tetrahedron meets few, and the tetrahedra of each bin, one bin after the other.
    edges = np.linalg.norm(boxes[:, [0, 0, 0, 1, 1, 2]] - boxes[:, [1, 2, 3, 2, 3, 3]], axis=2)
    extent = np.maximum(end - begin, 1e-12 * float((end - begin).max() or 1.0))
    side = float((extent.prod() / max(1.0, BINS_PER_CELL * len(tetrahedra))) ** (1 / 3))
    bins = np.clip(np.ceil(extent / side), 1, 512).astype(np.int64)
    sides = extent / bins
    first = np.clip(np.floor((low - begin) / sides), 0, bins - 1).astype(np.int64)
    last = np.clip(np.floor((high - begin) / sides), 0, bins - 1).astype(np.int64)
    owner, at = _lattice(first, last + 1)
    number = (at[:, 2] * bins[1] + at[:, 1]) * bins[0] + at[:, 0]
    order = np.argsort(number, kind="stable")
    begins = np.searchsorted(number[order], np.arange(int(bins.prod()) + 1))
    # Neighbours by their faces; −1 at the border.
    halves = find_neighbours(tetrahedra.astype(np.uint32), len(places)).halves
    padded = np.zeros((len(vectors), 4), np.float32)
    padded[:, :3] = vectors
    return Cells(
        places.reshape(-1),
        tetrahedra.reshape(-1),
        np.where(halves == NONE, -1, halves.astype(np.int64) // 4).reshape(-1),
        padded.reshape(-1),
        on_cells,
        begin,
        sides,
        tuple(bins.tolist()),
        begins.astype(np.int64),
        owner[order].astype(np.int64),
        float(edges.mean()),
    )
