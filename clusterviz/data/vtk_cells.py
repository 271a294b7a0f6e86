"""Cells as VTK has them, in files and in memory: types, offsets and indices of points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import (
    Attributes,
    check_attributes,
    named_arrays,
    positions_of,
    triangulate,
    triangulate_strips,
)
from clusterviz.data.unstructured import FACES, Polyhedra, UnstructuredGrid, grid_of_blocks, linearised, nodes_of
from clusterviz.data.vtk_image import HIDDEN_POINT, UNDRAWN_CELLS, drawn_cells, some_cells, split_ghosts
from clusterviz.errors import DataError

KINDS = {1: "vertex", 2: "vertex", 3: "line", 4: "line", 5: "triangle", 6: "triangle", 7: "polygon", 8: "quad"}
KINDS |= {9: "quad", 10: "tetra", 11: "hexahedron", 12: "hexahedron", 13: "wedge", 14: "pyramid", 21: "line"}
KINDS |= {22: "triangle", 23: "quad", 24: "tetra10", 25: "hexahedron20", 26: "wedge15", 27: "pyramid13", 28: "quad"}
KINDS |= {29: "hexahedron27", 30: "quad", 32: "wedge18", 34: "triangle", 37: "pyramid14"}
"""Names of VTK's types of cells."""
NODES = {kind: nodes_of(name) for kind, name in KINDS.items() if name.startswith(tuple(FACES))}
VOXEL, POLYHEDRON, STRIP, PIXEL = 11, 42, 6, 8
FLAT = {"triangle": 3, "quad": 4, "polygon": None}
"""Corners of flat cells with an area; None: any number."""


def grid_of_cells(
    points: NDArray[np.floating],
    types: NDArray[np.integer],
    offsets: NDArray[np.int64],
    corners: NDArray[np.int64],
    of_points: Attributes,
    of_cells: Attributes,
    where: str,
    polyhedra: Polyhedra | None = None,
) -> UnstructuredGrid:
    """Return the grid of VTK's arrays.

    Parameters
    ----------
    offsets : int64 (m + 1,); cell i has the points corners[offsets[i]:offsets[i + 1]]
    polyhedra : cells of type 42, in their order
    """
    if len(offsets) != len(types) + 1 or (np.diff(offsets) < 0).any() or offsets[0] != 0 or offsets[-1] > len(corners):
        allowed = f"{len(types)} + 1 that rise from 0 to {len(corners)}"
        raise DataError("the cells' offsets are wrong", where=where, found=f"{len(offsets)} offsets", allowed=allowed)
    check_attributes(of_points, len(points), "points", where)
    check_attributes(of_cells, len(types), "cells", where)
    of_points, of_cells, types, offsets, corners, polyhedra = _visible(
        of_points, of_cells, types, offsets, corners, polyhedra, where
    )
    counts = np.diff(offsets)
    blocks, order = list[tuple[str, NDArray[np.int64] | Polyhedra]](), [np.zeros(0, np.int64)]
    is_surface = not np.isin(types, [*NODES, POLYHEDRON]).any()
    for kind in np.unique(types).tolist():
        if kind == POLYHEDRON and polyhedra is not None:
            blocks.append(("polyhedron", polyhedra))
            order.append(np.flatnonzero(types == kind))
            continue
        if kind not in KINDS:
            found = f"VTK's type {kind}" + (", a polyhedron" if kind == POLYHEDRON else "")
            allowed = ", ".join(dict.fromkeys(KINDS.values()))
            raise DataError("cells of an unsupported kind", where=where, found=found, allowed=allowed)
        rows = np.flatnonzero(types == kind)
        if is_surface and KINDS[kind] in FLAT:
            triangles, cells = _flat_cells(kind, rows, offsets, corners, where)
            blocks.append(("triangle", triangles))
            order.append(cells)
            continue
        nodes = NODES.get(kind, 1)  # of a flat cell none is used
        wrong = counts[rows] < nodes if kind not in NODES else counts[rows] != nodes
        if wrong.any():
            found = f"a {KINDS[kind]} of {counts[rows][wrong][0]} points"
            raise DataError("a cell has an impossible length", where=where, found=found, allowed=nodes)
        if rows[-1] - rows[0] == len(rows) - 1 and kind in NODES:
            own = corners[offsets[rows[0]] : offsets[rows[-1] + 1]].reshape(-1, nodes)
        else:
            own = corners[offsets[rows][:, None] + np.arange(nodes)]
        blocks.append((KINDS[kind], own[:, [0, 1, 3, 2, 4, 5, 7, 6]] if kind == VOXEL else own))
        order.append(rows)
    numbers = np.concatenate(order)
    return linearised(points, blocks, of_points, {name: array[numbers] for name, array in of_cells.items()}, where)


def _visible(
    of_points: Attributes,
    of_cells: Attributes,
    types: NDArray[np.integer],
    offsets: NDArray[np.int64],
    corners: NDArray[np.int64],
    polyhedra: Polyhedra | None,
    where: str,
) -> tuple[Attributes, Attributes, NDArray[np.integer], NDArray[np.int64], NDArray[np.int64], Polyhedra | None]:
    """Return a grid's arrays, and its cells that are drawn, with theirs; see `vtk_ghosts`."""
    of_points, point_bits = split_ghosts(of_points, len(next(iter(of_points.values()), ())))
    of_cells, bits = split_ghosts(of_cells, len(types))
    if not point_bits.any() and not bits.any():
        return of_points, of_cells, types, offsets, corners, polyhedra
    is_drawn = drawn_cells(offsets, corners, bits, point_bits)
    if polyhedra is not None:
        own = types == POLYHEDRON  # whose points may lie in a stream
        is_drawn[own] = (bits[own] & UNDRAWN_CELLS == 0) & ~polyhedra.touched(point_bits & HIDDEN_POINT != 0, where)
        polyhedra = polyhedra.some(is_drawn[own])
    of_kept = {name: array[is_drawn] for name, array in of_cells.items()}
    return of_points, of_kept, types[is_drawn], *some_cells(offsets, corners, is_drawn), polyhedra


def _flat_cells(
    kind: int, rows: NDArray[np.int64], offsets: NDArray[np.int64], corners: NDArray[np.int64], where: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    found, sides = np.diff(offsets)[rows], FLAT[KINDS[kind]]
    if sides is not None and kind != STRIP and (found < sides).any():
        raise DataError("a cell has an impossible length", where=where, found=f"{found.min()} points", allowed=sides)
    counts = found if sides is None or kind == STRIP else np.full(len(rows), sides)
    ends = np.append(0, np.cumsum(counts))
    chosen = corners[np.repeat(offsets[rows] - ends[:-1], counts) + np.arange(ends[-1])]
    if kind == PIXEL:
        chosen = chosen.reshape(-1, 4)[:, [0, 1, 3, 2]].ravel()
    triangles, cell = (triangulate_strips if kind == STRIP else triangulate)(ends, chosen)
    return triangles.astype(np.int64), rows[cell]


def is_grid(given: Any) -> bool:
    """Return whether an object is an unstructured grid of this package, pyvista or meshio, or pyvista's curved one."""
    is_meshio = hasattr(given, "cells") and hasattr(given, "cell_data") and not hasattr(given, "faces")
    is_curved = hasattr(given, "dimensions") and hasattr(given, "cast_to_unstructured_grid")
    return isinstance(given, UnstructuredGrid) or hasattr(given, "celltypes") or is_meshio or is_curved


def as_grid(given: Any, where: str) -> UnstructuredGrid:
    """Return an unstructured grid in memory, as users of other libraries have it.

    Parameters
    ----------
    given : an `UnstructuredGrid`, a grid of pyvista, a mesh of meshio, or points (n, 3), tetrahedra
        (m, 4) and scalars (n,) or (m,), which become the array values
    """
    if isinstance(given, UnstructuredGrid):
        return given
    try:
        if not hasattr(given, "celltypes") and hasattr(given, "cast_to_unstructured_grid"):
            given = given.cast_to_unstructured_grid()
        if hasattr(given, "celltypes"):
            points, types = positions_of(given.points), np.asarray(given.celltypes)
            ends = given.cell_offsets if hasattr(given, "cell_offsets") else given.offset  # of pyvista before 0.49
            offsets, corners = np.asarray(ends, np.int64), np.asarray(given.cell_connectivity, np.int64)
            of_points, of_cells = named_arrays(given, "point", len(points)), named_arrays(given, "cell", len(types))
            return grid_of_cells(points, types, offsets, corners, of_points, of_cells, where)
        if is_grid(given):
            return grid_of_blocks(given, where)
        points, cells, values = positions_of(given[0]), np.asarray(given[1]), np.asarray(given[2])
        of_one: tuple[Attributes, Attributes] = ({"values": values}, {})
        arrays = of_one if len(values) == len(points) else of_one[::-1]
        return UnstructuredGrid(where, points, {"tetra": cells}, *arrays)
    except (TypeError, ValueError, IndexError, KeyError) as error:
        allowed = "points, tetrahedra and scalars, or a grid of pyvista or meshio"
        raise DataError("not an unstructured grid", where=where, found=type(given).__name__, allowed=allowed) from error
