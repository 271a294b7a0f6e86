"""Cells of VTK files, XML, legacy or HDF5: types, offsets and indices of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import Attributes, check_attributes
from clusterviz.data.unstructured import UnstructuredGrid, linearised
from clusterviz.errors import DataError

KINDS = {
    **dict.fromkeys((1, 2), "vertex"),
    **dict.fromkeys((3, 4, 21), "line"),
    **dict.fromkeys((5, 6, 22, 34), "triangle"),
    **dict.fromkeys((8, 9, 23, 28, 30), "quad"),
    7: "polygon",
    10: "tetra",
    11: "hexahedron",
    12: "hexahedron",
    13: "wedge",
    14: "pyramid",
    24: "tetra10",
    25: "hexahedron20",
    26: "wedge15",
    27: "pyramid13",
    29: "hexahedron27",
    32: "wedge18",
    37: "pyramid14",
}
"""Names of VTK's types of cells."""
NODES = {10: 4, 11: 8, 12: 8, 13: 6, 14: 5, 24: 10, 25: 20, 26: 15, 27: 13, 29: 27, 32: 18, 37: 14}
VOXEL, POLYHEDRON = 11, 42


def grid_of_cells(
    points: NDArray[np.floating],
    types: NDArray[np.integer],
    offsets: NDArray[np.int64],
    corners: NDArray[np.int64],
    of_points: Attributes,
    of_cells: Attributes,
    where: str,
) -> UnstructuredGrid:
    """Return the grid of VTK's arrays.

    Parameters
    ----------
    types : (m,)
    offsets : int64 (m + 1,); cell i has the points corners[offsets[i]:offsets[i + 1]]

    Raises
    ------
    DataError
        Offsets that do not rise, polyhedra or other unsupported types, or as of `linearised`.
    """
    counts = np.diff(offsets)
    if len(offsets) != len(types) + 1 or (counts < 0).any() or offsets[0] != 0 or offsets[-1] > len(corners):
        allowed = f"{len(types)} + 1 that rise from 0 to {len(corners)}"
        raise DataError("the cells' offsets are wrong", where=where, found=f"{len(offsets)} offsets", allowed=allowed)
    check_attributes(of_cells, len(types), "cells", where)
    blocks, order = list[tuple[str, NDArray[np.int64]]](), [np.zeros(0, np.int64)]
    for kind in np.unique(types).tolist():
        if kind not in KINDS:
            found = f"VTK's type {kind}" + (", a polyhedron" if kind == POLYHEDRON else "")
            allowed = ", ".join(dict.fromkeys(KINDS.values()))
            raise DataError("cells of an unsupported kind", where=where, found=found, allowed=allowed)
        rows = np.flatnonzero(types == kind)
        nodes = NODES.get(kind, 1)  # of a flat cell none is used
        wrong = counts[rows] < nodes if kind not in NODES else counts[rows] != nodes
        if wrong.any():
            found = f"a {KINDS[kind]} of {counts[rows][wrong][0]} points"
            raise DataError("a cell has an impossible length", where=where, found=found, allowed=nodes)
        own = corners[offsets[rows][:, None] + np.arange(nodes)]
        blocks.append((KINDS[kind], own[:, [0, 1, 3, 2, 4, 5, 7, 6]] if kind == VOXEL else own))
        order.append(rows)
    numbers = np.concatenate(order)
    return linearised(points, blocks, of_points, {name: array[numbers] for name, array in of_cells.items()}, where)
