"""Tetrahedra with a scalar field, in which integrals along rays are exact: what is drawn of an unstructured grid.

Cells are cut by one rule: each face with four corners along the diagonal from its smallest corner, and the cell into
the tetrahedra between its smallest corner and the triangles of the faces that do not have it. A hexahedron becomes 6, a
wedge 3, a pyramid 2. Two cells cut the face between them alike, so there are no gaps and nothing is drawn twice.
"Smallest" is by a hash of the position (`merge_equal`), so cells fit also where the points of both are duplicates, and
where each is in another file and cut on another rank.

In a tetrahedron the scalar is linear, or constant for an array of cells. So a hexahedron's field is piecewise linear,
not trilinear; the difference falls with the square of its size.

References
----------
J. Dompierre, P. Labbé, M.-G. Vallet, R. Camarero: How to subdivide pyramids, prisms and hexahedra into tetrahedra, 8th
International Meshing Roundtable, 1999. (Their rule; hexahedra are never cut into 5 here.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.faces import NONE, find_neighbours
from clusterviz.data.geometry import STEP, Bounds, Geometry, Mesh, Points, bounds_of, merge_equal
from clusterviz.data.predicates import orientation
from clusterviz.data.unstructured import CORNERS, FACES, UnstructuredGrid, check_volume
from clusterviz.errors import DataError

MOST = 2**30 - 1
"""Points or tetrahedra of a grid: the numbers of their half-faces are uint32, and the last stands for none."""


@dataclass(frozen=True, eq=False)
class Tetrahedra:
    """Tetrahedra with a volume, and one scalar for each of their points or for each of them.

    Attributes
    ----------
    points : float32 or float64 (n, 3), world; each is used, and equal ones differ in their scalars
    corners : uint32 (m, 4), rows of `points`; the first three are counter-clockwise seen from the fourth
    values : float32 or float64, (n,) of points or (m,) of tetrahedra, finite
    on_cells : whether they are those of tetrahedra
    cells : uint32 (m,), ascending: the cell of the grid that each is a part of
    rows : uint32 (n,), ascending: the first point of the grid that is equal to each of `points`
    counts : what the grid has that is not drawn, or is drawn otherwise, by the names of `COUNTS`
    """

    name: str
    points: NDArray[Any]
    corners: NDArray[np.uint32]
    values: NDArray[Any]
    on_cells: bool
    cells: NDArray[np.uint32]
    array: str = ""
    rows: NDArray[np.uint32] = field(default_factory=lambda: np.empty(0, np.uint32))
    counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def bounds(self) -> Bounds | None:
        """Corners of the axis-aligned box around all tetrahedra; None if there are none."""
        return bounds_of(self.points)


COUNTS = {
    "inverted": "cells whose corners are in the order of a mirror image",
    "folded": "cells that overlap themselves",
    "flat": "cells without a volume",
    "misplaced": "cells with a corner that is not finite",
    "invalid": "cells with a value that is not finite, which are transparent",
    "duplicates": "points at the position of another one",
    "unused": "points of no cell",
}
"""Names in `Tetrahedra.counts`, and what they count. Only flat, misplaced and invalid cells are not drawn."""


def make_tetrahedra(grid: UnstructuredGrid, array: str | None = None) -> Tetrahedra:
    check_volume(grid)
    values, on_cells, name = grid.array(array)
    values = values.astype(np.float32 if values.dtype.itemsize <= 2 or values.dtype == np.float32 else np.float64)
    place, placed = merge_equal(grid.points)[1], np.isfinite(grid.points).all(axis=1)
    known = np.isfinite(values)
    counts, parts, owners, begin = dict.fromkeys(COUNTS, 0), list[NDArray[np.uint32]](), list[NDArray[np.uint32]](), 0
    if max(len(grid.points), grid.count) > MOST:
        _refuse(grid, grid.count)
    used = np.zeros(len(grid.points), bool)
    chunks = ((kind, each[n : n + STEP]) for kind, each in grid.cells.items() for n in range(0, len(each), STEP))
    for kind, corners in chunks:
        used[corners.ravel()] = True
        numbers, begin = np.arange(begin, begin + len(corners)), begin + len(corners)
        here = placed[corners].all(axis=1)
        valid = known[numbers] if on_cells else known[corners].all(axis=1)
        counts["misplaced"] += int((~here).sum())
        counts["invalid"] += int((here & ~valid).sum())
        numbers, some = numbers[here & valid], corners[here & valid].astype(np.int64)
        pieces = _pieces(kind, some, place)
        signs = orientation(*(grid.points[pieces[..., n].ravel()].astype(np.float64) for n in range(4)))
        signs = signs.reshape(pieces.shape[:2])
        has_positive, has_negative = (signs > 0).any(axis=1), (signs < 0).any(axis=1)
        counts["flat"] += int((~has_positive & ~has_negative).sum())
        counts["folded"] += int((has_positive & has_negative).sum())
        if kind != "wedge":  # whose corners VTK and finite elements order differently
            counts["inverted"] += int((has_negative & ~has_positive).sum())
        pieces[signs < 0] = pieces[signs < 0][:, [1, 0, 2, 3]]
        parts.append(pieces[signs != 0].astype(np.uint32))
        owners.append(np.repeat(numbers, (signs != 0).sum(axis=1)).astype(np.uint32))
    whole = np.concatenate([np.empty((0, 4), np.uint32), *parts])
    cells = np.concatenate([np.empty(0, np.uint32), *owners])
    if len(whole) > MOST:
        _refuse(grid, len(whole))
    counts["unused"] = int((~used).sum())
    counts["duplicates"] = len(place) - int(place.max(initial=-1)) - 1
    rows, corners = _compact(grid.points, whole, place if on_cells else groups_with_values(place, values))
    return Tetrahedra(
        grid.name,
        grid.points[rows],
        corners,
        values[cells] if on_cells else values[rows],
        on_cells,
        cells,
        name,
        rows.astype(np.uint32),
        counts,
    )


def _refuse(grid: UnstructuredGrid, tetrahedra: int) -> None:
    found = f"{len(grid.points)} points, {tetrahedra} tetrahedra"
    raise DataError("too large", where=grid.name, found=found, allowed=f"at most {MOST} of each")


def _pieces(kind: str, corners: NDArray[np.int64], place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the tetrahedra (m, t, 4) of cells (m, c); `place` numbers the positions of the points."""
    if kind == "tetra":
        return corners[:, None].copy()
    keys = place[corners]
    smallest = keys.argmin(axis=1)
    found = np.empty((len(corners), PIECES[kind], 4), np.int64)
    for apex in range(CORNERS[kind]):
        rows, slot = np.flatnonzero(smallest == apex), 0
        for face in FACES[kind]:
            if apex in face:
                continue
            own, along = corners[rows][:, face], np.arange(len(rows))[:, None]
            if len(face) == 4:  # from its smallest corner on
                turned = (keys[rows][:, face].argmin(axis=1)[:, None] + np.arange(4)) % 4
                own = own[along, turned]
            for n in range(len(face) - 2):
                found[rows, slot, 0], found[rows, slot, 1] = own[:, 0], own[:, n + 2]
                found[rows, slot, 2], found[rows, slot, 3] = own[:, n + 1], corners[rows, apex]
                slot += 1
    return found


PIECES = {"tetra": 1, "pyramid": 2, "wedge": 3, "hexahedron": 6}


def groups_with_values(place: NDArray[np.int64], values: NDArray[Any]) -> NDArray[np.int64]:
    """Return numbers of points that differ where positions, which have the numbers `place`, or values do."""
    if int(place.max(initial=-1)) + 1 == len(place):
        return place
    return merge_equal(np.stack([place.astype(np.float64), values.astype(np.float64)], axis=1))[1]


def _compact(
    points: NDArray[Any], corners: NDArray[np.uint32], group: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.uint32]]:
    """Return the rows of the points that are used, the first of each group, ascending, and the corners among them."""
    first = np.empty(int(group.max(initial=-1)) + 1, np.int64)
    first[group[::-1]] = np.arange(len(points))[::-1]  # the last one written is the smallest
    row, used = first[group], np.zeros(len(points), bool)
    used[corners.ravel()] = True
    used[row[used]], used[row != np.arange(len(points))] = True, False
    number = np.cumsum(used, dtype=np.uint32) - np.uint32(1)
    return np.flatnonzero(used), number[row][corners]


def has_scalars(grid: UnstructuredGrid) -> bool:
    """Return whether a grid is drawn as a volume: it has cells with a volume, and an array of one number each."""
    arrays = (*grid.point_arrays.values(), *grid.cell_arrays.values())
    return grid.count > 0 and any(array.size == len(array) for array in arrays)


def outside_of(grid: UnstructuredGrid) -> Geometry:
    """Return the surface that a grid is, its points if it has neither faces nor volumes, or the faces around its cells.

    Arrays of points are kept, of a surface those of cells too.
    """
    if not grid.count:
        points = None if grid.surface else Points(grid.name, grid.points, grid.point_arrays)
        return Geometry(mesh=grid.surface, points=points)
    blank = {"any": np.zeros(len(grid.points), np.float32)}
    cut = make_tetrahedra(replace(grid, point_arrays=blank, cell_arrays={}))
    faces = find_neighbours(cut.corners, len(cut.points)).faces()
    corners, sides = faces.corners[faces.is_boundary], faces.sides[faces.is_boundary]
    inward = sides[:, 0] == NONE  # normals point to the second side
    corners[inward] = corners[inward][:, ::-1]
    return Geometry(Mesh(grid.name, cut.points, corners, {n: a[cut.rows] for n, a in grid.point_arrays.items()}))
