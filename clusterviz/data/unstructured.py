"""Unstructured grids in memory: points, cells of four kinds, and their arrays.

Cells are tetrahedra, pyramids, wedges (prisms) and hexahedra with VTK's order of corners. Curved cells of second order
are subdivided, and polyhedra cut into tetrahedra (`linearised`). What cannot be drawn stays in the arrays;
`tetrahedra.py` leaves it out and counts it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import UnnamedPartError
from clusterviz.data.geometry import (
    Attributes,
    Bounds,
    Mesh,
    bounds_of,
    check_attributes,
    check_indices,
    check_positions,
    hashes,
    joined_arrays,
    triangulate,
)
from clusterviz.errors import DataError

FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "tetra": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "pyramid": ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    "wedge": ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "hexahedron": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
"""Corners of the faces of each kind of cell, counter-clockwise seen from outside; cells are kept in this order."""
CORNERS = {kind: 1 + max(map(max, faces)) for kind, faces in FACES.items()}


@dataclass(frozen=True, eq=False)
class UnstructuredGrid:
    """Unstructured grid.

    Attributes
    ----------
    points : float32 or float64 (n, 3), world
    cells : int (m, c) by kind, indices of points in VTK's order; kinds in the order of `FACES`
    point_arrays : arrays (n,) or (n, components) by name
    cell_arrays : of all cells, those of each kind one after another
    ignored : number of cells of the file without a volume: points, lines, triangles, …
    surface : triangles of the file's flat cells, if it has no others; None without
    curved : by the name of a point array, the largest difference along the edges of curved cells that their
        subdivision makes; "" for the edges themselves, world; empty without curved cells

    Raises
    ------
    DataError
        Wrong shapes or types, arrays of another length, or indices out of range.
    """

    name: str
    points: NDArray[Any]
    cells: Mapping[str, NDArray[np.integer[Any]]]
    point_arrays: Attributes = field(default_factory=dict)
    cell_arrays: Attributes = field(default_factory=dict)
    ignored: int = 0
    curved: Mapping[str, float] = field(default_factory=dict)
    surface: Mesh | None = None

    def __post_init__(self) -> None:
        check_positions(self.points, self.name)
        for kind, corners in self.cells.items():
            if kind not in CORNERS or corners.ndim != 2 or corners.shape[1] != CORNERS[kind]:
                found, allowed = f"{kind} {corners.shape}", ", ".join(f"{k} (m, {c})" for k, c in CORNERS.items())
                raise DataError("not cells", where=self.name, found=found, allowed=allowed)
            if corners.dtype.kind not in "iu":
                raise DataError("not indices", where=self.name, found=corners.dtype, allowed="integers")
            check_indices(corners, len(self.points), self.name)
        object.__setattr__(self, "cells", {kind: self.cells[kind] for kind in FACES if kind in self.cells})
        check_attributes(self.point_arrays, len(self.points), "points", self.name)
        check_attributes(self.cell_arrays, self.count, "cells", self.name)

    @property
    def count(self) -> int:
        return sum(len(corners) for corners in self.cells.values())

    @property
    def bounds(self) -> Bounds | None:
        """Corners of the axis-aligned box around the finite points of cells; None if there are none."""
        used = np.zeros(len(self.points), bool)
        for corners in self.cells.values():
            used[corners.ravel()] = True
        return bounds_of(self.points[used & np.isfinite(self.points).all(axis=1)])

    def part(self, number: int, parts: int) -> UnstructuredGrid:
        """Return one of equal shares of the cells, in their order, with all points."""
        first, last = (self.count * n // parts for n in (number, number + 1))
        cells, begin = dict[str, NDArray[np.integer[Any]]](), 0
        for kind, corners in self.cells.items():
            cells[kind] = corners[max(0, first - begin) : max(0, last - begin)]
            begin += len(corners)
        of_cells = {name: array[first:last] for name, array in self.cell_arrays.items()}
        return UnstructuredGrid(self.name, self.points, cells, self.point_arrays, of_cells)

    def array(self, name: str | None) -> tuple[NDArray[Any], bool, str]:
        """Return an array of scalars, (n,) of points or (m,) of cells, whether it belongs to cells, and its name.

        Parameters
        ----------
        name : of the array; the points' if points and cells have one; None: the only array of scalars
        """
        found = [(key, array, on_cells) for key, array, on_cells in self._arrays() if name in (None, key)]
        scalars = [each for each in found if each[1].size == len(each[1]) and each[1].dtype.kind in "iufb"]
        names = ", ".join(dict.fromkeys(key for key, array, _ in self._arrays() if array.size == len(array)))
        if found and not scalars:
            (key, array, _), allowed = found[0], names or "none: no array of the file has one number each"
            raise DataError("not one number each", where=f"{self.name}:{key}", found=array.shape, allowed=allowed)
        if not found:
            allowed = names or "none: the file has no arrays"
            raise DataError("no such array", where=self.name, found=name or "no array", allowed=allowed)
        named = list(dict.fromkeys(key for key, _, _ in scalars))
        if name is None and len(named) > 1:
            raise UnnamedPartError("array", named, where=self.name, found=names, allowed="array: NAME")
        return scalars[0][1].reshape(-1), scalars[0][2], scalars[0][0]

    def _arrays(self) -> list[tuple[str, NDArray[Any], bool]]:
        of_points = [(name, array, False) for name, array in self.point_arrays.items()]
        return of_points + [(name, array, True) for name, array in self.cell_arrays.items()]


def joined_grids(grids: Sequence[UnstructuredGrid], name: str) -> UnstructuredGrid:
    """Return the cells of several grids as one grid, with the arrays that all of them have; points are not merged."""
    some = [grid for grid in grids if grid.count] or grids[:1]
    begins = np.cumsum([0, *(len(grid.points) for grid in some)])
    cells = {
        kind: np.concatenate([g.cells[kind] + first for g, first in zip(some, begins, strict=False) if kind in g.cells])
        for kind in FACES
        if any(kind in grid.cells for grid in some)
    }
    # The cells of all grids are ordered by their kinds.
    kinds = [n for grid in some for n, kind in enumerate(FACES) for _ in range(kind in grid.cells)]
    counts = [len(corners) for grid in some for corners in grid.cells.values()]
    order = np.argsort(np.repeat(np.array(kinds, np.uint8), counts), kind="stable")
    of_cells = {key: array[order] for key, array in joined_arrays([grid.cell_arrays for grid in some]).items()}
    return UnstructuredGrid(
        name,
        np.concatenate([grid.points for grid in some]),
        cells,
        joined_arrays([grid.point_arrays for grid in some]),
        of_cells,
        sum(grid.ignored for grid in grids),
        {key: max(grid.curved.get(key, 0.0) for grid in some) for grid in some for key in grid.curved},
        None if any(grid.count for grid in grids) else _joined_surfaces([g.surface for g in grids if g.surface], name),
    )


def _joined_surfaces(meshes: Sequence[Mesh], name: str) -> Mesh | None:
    """Return the triangles of several meshes as one mesh, with the arrays that all of them have."""
    if not meshes:
        return None
    begins = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        name,
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + first for mesh, first in zip(meshes, begins, strict=False)]),
        joined_arrays([mesh.vertex_attributes for mesh in meshes]),
        joined_arrays([mesh.triangle_attributes for mesh in meshes]),
    )


def check_volume(grid: UnstructuredGrid) -> None:
    """Refuse a grid whose cells are all without a volume; a piece of a grid may have such cells only."""
    if grid.ignored and not grid.count:
        found, allowed = f"{grid.ignored} others", f"{', '.join(FACES)}; a surface is one of meshes"
        raise DataError("no cells with a volume", where=grid.name, found=found, allowed=allowed)


def linearised(
    points: NDArray[Any],
    blocks: Sequence[tuple[str, NDArray[np.integer[Any]] | Polyhedra]],
    of_points: Attributes,
    of_cells: Attributes,
    where: str,
) -> UnstructuredGrid:
    """Return the grid of blocks of cells as files have them; curved cells are subdivided, polyhedra cut.

    A cell of second order becomes 8 cells (a pyramid 10) between its corners and the nodes on its edges and faces.
    Faces without a node get one from those of their edges, so neighbours fit. The difference from the curved cell falls
    with the square of the cells' size; `UnstructuredGrid.curved` states it.

    Parameters
    ----------
    blocks : kind and corners (m, c) of some cells, by meshio's names, or `Polyhedra`; kinds without a volume are
        dropped
    of_points, of_cells : arrays by name, (n, …), and of all cells in the order of the blocks
    """
    ignored, begin, curved, flat = 0, 0, dict[str, float](), list[tuple[NDArray[Any], NDArray[np.int64]]]()
    cells: dict[str, list[NDArray[Any]]] = {kind: [] for kind in FACES}
    rows: dict[str, list[NDArray[np.int64]]] = {kind: [] for kind in FACES}
    for kind, corners in blocks:
        number, begin = np.arange(begin, begin + len(corners)), begin + len(corners)
        if isinstance(corners, Polyhedra):
            points, of_points, parts, owners = corners.cut(points, of_points, where)
            cells["tetra"].append(parts)
            rows["tetra"].append(number[owners])
        elif kind in SECOND_ORDER:
            order = SECOND_ORDER[kind]
            check_indices(corners, len(points), where)
            for name, value in order.differences(points, of_points, corners).items():
                curved[name] = max(curved.get(name, 0.0), value)
            points, of_points, nodes = order.with_nodes(points, of_points, corners)
            for part, local in order.parts:
                cells[part].append(nodes[:, local].reshape(-1, CORNERS[part]))
                rows[part].append(np.repeat(number, len(local)))
        elif kind in FACES:
            cells[kind].append(corners)
            rows[kind].append(number)
        elif kind.startswith(FLAT_KINDS):
            ignored += len(corners)
            width = int(corners.shape[1])
            sides = FLAT_SIDES.get(kind.rstrip("0123456789"), width)
            if 3 <= sides <= width:
                triangles, polygon = triangulate(np.arange(len(corners) + 1) * sides, corners[:, :sides].ravel())
                flat.append((triangles, number[polygon]))
        else:
            allowed = ", ".join([*FACES, *SECOND_ORDER, *FLAT_KINDS, "polyhedra of VTK"])
            raise DataError("cells of an unsupported kind", where=where, found=kind, allowed=allowed)
    order_of = np.concatenate([np.zeros(0, np.int64), *(each for kind in FACES for each in rows[kind])])
    check_attributes(of_cells, begin, "cells", where)
    kept = {kind: np.concatenate(each) if len(each) > 1 else each[0] for kind, each in cells.items() if each}
    of_kept = {name: array[order_of] for name, array in of_cells.items()}
    surface = None
    if flat and not kept:
        corners_of, numbers = (np.concatenate(each) for each in zip(*flat, strict=True))
        surface = Mesh(where, points, corners_of, of_points, {name: array[numbers] for name, array in of_cells.items()})
    return UnstructuredGrid(where, points, kept, of_points, of_kept, ignored, curved, surface)


def grid_of_blocks(mesh: Any, where: str) -> UnstructuredGrid:
    """Return the grid of a mesh with the attributes of meshio's; arrays that are not of numbers are left out."""
    blocks = [(block.type, np.asarray(block.data)) for block in mesh.cells]
    count, points = sum(len(corners) for _, corners in blocks), np.asarray(mesh.points)
    if points.ndim == 2 and points.shape[1] == 2:
        points = np.pad(points, ((0, 0), (0, 1)))
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError("not three-dimensional", where=where, found=points.shape, allowed="points (n, 3)")
    points = points.astype(np.promote_types(points.dtype, np.float32), copy=False)
    parts = {key: [np.atleast_1d(part) for part in each] for key, each in mesh.cell_data.items()}
    alike = {key: each for key, each in parts.items() if len({part.shape[1:] for part in each}) == 1}
    of_points = {key: np.asarray(array) for key, array in mesh.point_data.items()}
    of_cells = {key: np.concatenate(each) for key, each in alike.items() if each}
    return linearised(points, blocks, _numbers(of_points, len(points)), _numbers(of_cells, count), where)


def _numbers(arrays: Attributes, count: int) -> Attributes:
    return {n: a for n, a in arrays.items() if a.dtype.kind in "iufb" and a.ndim in (1, 2) and len(a) == count}


FLAT_KINDS = ("vertex", "line", "triangle", "quad", "polygon")
FLAT_SIDES = {"vertex": 1, "line": 2, "triangle": 3, "quad": 4}
"""Corners of flat cells, which come before their nodes of higher order; a polygon has any number."""


def nodes_of(kind: str) -> int:
    """Return the number of nodes of a cell by meshio's name of its kind; 0 if it may have any."""
    linear = kind.rstrip("0123456789")
    return int(kind.removeprefix(linear) or (FLAT_SIDES | CORNERS).get(linear, 0))


@dataclass(frozen=True, eq=False)
class Polyhedra:
    """Cells between polygons.

    Attributes
    ----------
    owners : int64 (f,), cell of each face
    begins, sizes : int64 (f,); face i has the corners values[begins[i]:begins[i] + sizes[i]]
    values : int (n,), indices of points among others
    """

    count: int
    owners: NDArray[np.int64]
    begins: NDArray[np.int64]
    sizes: NDArray[np.int64]
    values: NDArray[np.int64]

    @classmethod
    def of_streams(cls, values: NDArray[np.int64], begins: NDArray[np.int64]) -> Polyhedra:
        """Return the cells of VTK's streams, which begin at some places: number of faces, and each with its length."""
        faces, at = values[begins], begins + 1
        owners, starts = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for number in range(int(faces.max(initial=0))):
            owners.append(np.flatnonzero(faces > number))
            starts.append(at[owners[-1]] + 1)
            at[owners[-1]] += values[starts[-1] - 1].clip(0) + 1
        start = np.concatenate(starts)
        return cls(len(begins), np.concatenate(owners), start, values[start - 1], values)

    def __len__(self) -> int:
        return self.count

    def some(self, is_kept: NDArray[np.bool_]) -> Polyhedra:
        faces, number = is_kept[self.owners], np.cumsum(is_kept) - 1
        kept = self.begins[faces], self.sizes[faces]
        return Polyhedra(int(is_kept.sum()), number[self.owners[faces]], *kept, self.values)

    def touched(self, is_one: NDArray[np.bool_], where: str) -> NDArray[np.bool_]:
        """Return which cells have one of some points, bool (count,)."""
        if not is_one.any():
            return np.zeros(self.count, bool)
        face, _, _, corners = self._corners(len(is_one), where)
        return np.bincount(self.owners[face], is_one[corners], self.count) > 0

    def _corners(self, points: int, where: str) -> tuple[NDArray[np.int64], ...]:
        """Return the face of each corner, its place in the face, the first corner of each face, and the corners."""
        ends = self.begins + self.sizes
        if (self.sizes < 3).any() or self.begins.min(initial=0) < 0 or ends.max(initial=0) > len(self.values):
            raise DataError("the faces of polyhedra are wrong", where=where, allowed="3 or more corners each")
        face, first = np.repeat(np.arange(len(self.sizes)), self.sizes), np.cumsum(self.sizes) - self.sizes
        within = np.arange(len(face)) - first[face]
        corners = self.values[self.begins[face] + within]
        check_indices(corners, points, where)
        return face, within, first, corners

    def cut(
        self, points: NDArray[Any], of_points: Attributes, where: str
    ) -> tuple[NDArray[Any], Attributes, NDArray[np.int64], NDArray[np.int64]]:
        """Return tetrahedra around the mean of each cell's corners, which is right for convex cells.

        Faces are fans around the corner with the smallest hash, as in `make_tetrahedra`, so that neighbours fit.

        Returns
        -------
        points, of_points : with the means behind the others
        tetrahedra : (t, 4)
        owners : int64 (t,), cell of each
        """
        face, within, first, corners = self._corners(len(points), where)
        smallest = np.lexsort((hashes(points)[corners], face))[first]
        ring = corners[first[face] + (within + (smallest - first)[face]) % self.sizes[face]]
        second = np.flatnonzero((within > 0) & (within < self.sizes[face] - 1))
        owner = self.owners[face[second]]
        cell, row = np.divmod(np.unique(self.owners[face] * len(points) + corners), len(points))
        used, begins = np.unique(cell, return_index=True)
        place = np.empty(self.count, np.int64)
        place[used] = np.arange(len(points), len(points) + len(used))
        joined = {}
        for name, array in {"": points, **of_points}.items():
            mean = array[:0].astype(np.float64)
            if len(used):
                mean = np.add.reduceat(array[row], begins, axis=0, dtype=np.float64)
            mean /= np.diff(begins, append=len(row)).reshape(-1, *(1,) * (array.ndim - 1))
            joined[name] = np.concatenate([array, _as_type(mean, array.dtype)])
        tetrahedra = np.stack([ring[first[face[second]]], ring[second], ring[second + 1], place[owner]], axis=1)
        a, b, c, d = (joined[""][corner].astype(np.float64) for corner in tetrahedra.T)
        inward = np.einsum("mx,mx->m", np.cross(b - a, c - a), d - a) < 0
        tetrahedra[inward] = tetrahedra[inward][:, [1, 0, 2, 3]]
        return joined.pop(""), joined, tetrahedra, owner


def _as_type(values: NDArray[np.float64], dtype: np.dtype[Any]) -> NDArray[Any]:
    return (values if dtype.kind == "f" else np.rint(values)).astype(dtype)


class _SecondOrder:
    """Cells of second order of one kind: nodes on edges, faces and inside, and the cells between them.

    A node is named by the corners that it lies between, in increasing order.
    """

    def __init__(self, linear: str, nodes: Sequence[tuple[int, ...]]) -> None:
        every, faces = tuple(range(CORNERS[linear])), [frozenset(face) for face in FACES[linear]]
        self.stored = [(corner,) for corner in every] + [tuple(sorted(node)) for node in nodes]

        def between(*corners: int) -> tuple[int, ...]:
            """Return the corners of the smallest edge, face or cell that has some corners."""
            around = [face for face in faces if face.issuperset(corners)]
            return tuple(sorted(frozenset(every).intersection(*around)))

        # Half of the cell at each corner, and what remains between them.
        named = {linear: [[between(corner, other) for other in every] for corner in every]}
        if linear == "tetra":
            ring = [(1, 2), (0, 2), (0, 3), (1, 3)]
            named["tetra"] += [[(0, 1), (2, 3), ring[n], ring[(n + 1) % 4]] for n in range(4)]
        elif linear == "wedge":
            bottom, middle, top = (
                [between(*pair) for pair in pairs]
                for pairs in (((0, 1), (1, 2), (2, 0)), ((0, 4), (1, 5), (2, 3)), ((3, 4), (4, 5), (5, 3)))
            )
            named["wedge"] += [bottom + middle, middle + top]
        elif linear == "pyramid":
            rim, base = [(n, 4) for n in range(4)], (0, 1, 2, 3)
            named["pyramid"].append([*rim[::-1], base])
            sides = [between(n, (n + 1) % 4) for n in range(4)]
            named["tetra"] = [[base, sides[n], rim[(n + 1) % 4], rim[n]] for n in range(4)]
        wanted = {node for cells in named.values() for cell in cells for node in cell}
        self.added = sorted(wanted - set(self.stored), key=lambda node: (len(node), node))
        place = {node: n for n, node in enumerate([*self.stored, *self.added])}
        self.parts = [
            (kind, np.array([[place[node] for node in cell] for cell in cells])) for kind, cells in named.items()
        ]
        self.edges = np.array([[*node, place[node]] for node in self.stored if len(node) == 2])

    def with_nodes(
        self, points: NDArray[Any], of_points: Attributes, corners: NDArray[np.integer[Any]]
    ) -> tuple[NDArray[Any], Attributes, NDArray[np.int64]]:
        corners = corners.astype(np.int64)
        nodes, more = [corners], {name: [array] for name, array in {"": points, **of_points}.items()}
        for node in self.added:
            own = corners[:, list(node)]
            edges = corners[:, [edge for a, b, edge in self.edges if {a, b} <= set(node)]]
            # In one order for both cells at a face, so that both get the same digits. Serendipity's shape functions.
            own, edges = np.sort(own, axis=1), np.sort(edges, axis=1)
            weight = 0.5 if len(node) == 4 else 0.25
            for arrays in more.values():
                given = arrays[0]
                made = weight * given[edges].astype(np.float64).sum(axis=1) - 0.25 * given[own].astype(np.float64).sum(
                    1
                )
                arrays.append(_as_type(made, given.dtype))
            begin = len(points) + sum(len(each) for each in more[""][1:-1])
            nodes.append(np.arange(begin, begin + len(corners))[:, None])
        joined = {name: np.concatenate(arrays) for name, arrays in more.items()}
        return joined.pop(""), joined, np.concatenate(nodes, axis=1)

    def differences(
        self, points: NDArray[Any], of_points: Attributes, corners: NDArray[np.integer[Any]]
    ) -> dict[str, float]:
        """Return the largest distance between a parabola on an edge and its two chords, of positions and arrays."""
        found = {}
        a, b, middle = (corners[:, places] for places in self.edges.T)
        for name, array in {"": points, **of_points}.items():
            if array.dtype.kind not in "iuf" or not len(corners):
                continue
            values = array.astype(np.float64)
            with np.errstate(invalid="ignore"):
                bent = (values[a] - 2 * values[middle] + values[b]) / 8
                size = np.sqrt((bent**2).sum(axis=2)) if bent.ndim == 3 else np.abs(bent)
            found[name] = float(np.nan_to_num(size, nan=0.0, posinf=0.0).max(initial=0.0))
        return found


_EDGES = {
    "tetra": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "pyramid": [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)],
    "wedge": [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    "hexahedron": [*((n, (n + 1) % 4) for n in range(4)), *((4 + n, 4 + (n + 1) % 4) for n in range(4))]
    + [(n, n + 4) for n in range(4)],
}
_SIDES = [(0, 3, 4, 7), (1, 2, 5, 6), (0, 1, 4, 5), (2, 3, 6, 7), (0, 1, 2, 3), (4, 5, 6, 7)]
SECOND_ORDER = {
    "tetra10": _SecondOrder("tetra", _EDGES["tetra"]),
    "pyramid13": _SecondOrder("pyramid", _EDGES["pyramid"]),
    "pyramid14": _SecondOrder("pyramid", [*_EDGES["pyramid"], (0, 1, 2, 3)]),
    "wedge15": _SecondOrder("wedge", _EDGES["wedge"]),
    "wedge18": _SecondOrder("wedge", [*_EDGES["wedge"], (0, 1, 3, 4), (1, 2, 4, 5), (0, 2, 3, 5)]),
    "hexahedron20": _SecondOrder("hexahedron", _EDGES["hexahedron"]),
    "hexahedron27": _SecondOrder("hexahedron", [*_EDGES["hexahedron"], *_SIDES, tuple(range(8))]),
}
"""Cells of second order by meshio's names, with VTK's order of nodes."""
