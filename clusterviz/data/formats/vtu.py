"""VTK's unstructured grids in XML (.vtu); see `clusterviz.data.vtk_xml`. `grid_files.py` reads their lists (.pvtu).

Pieces of a file are joined; of arrays, those that all pieces have are kept. Ghost cells (`vtkGhostType` 1) are dropped,
as another piece has them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import require_file
from clusterviz.data.geometry import check_indices
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vtk_cells import grid_of_cells
from clusterviz.data.vtk_xml import XmlPiece, joined, scan_xml
from clusterviz.errors import DataError

GHOST, DUPLICATE = "vtkGhostType", 1


def read_vtu(path: Path) -> UnstructuredGrid:
    """Read a .vtu file.

    Raises
    ------
    DataError
        Not such a file, damaged or truncated, counts that do not fit, or indices out of range.
    """
    return _read(_pieces(path), str(path))


def _pieces(path: Path) -> list[XmlPiece]:
    size = require_file(path)
    layout = scan_xml(path, "UnstructuredGrid")
    if not layout.pieces:
        raise DataError("no piece", where=str(path), allowed="<Piece …>")
    return [XmlPiece(path, size, layout, number) for number in range(len(layout.pieces))]


def _read(pieces: list[XmlPiece], where: str) -> UnstructuredGrid:
    points, lengths, corners = list[NDArray[Any]](), [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    types, of_points, of_cells = (
        [np.zeros(0, np.uint8)],
        list[dict[str, NDArray[Any]]](),
        list[dict[str, NDArray[Any]]](),
    )
    begin = 0
    for piece in pieces:
        points.append(piece.points())
        count = piece.count("NumberOfCells")
        ends, along = piece.cells("Cells", count)
        own = np.diff(ends, prepend=0)
        if (own < 0).any():
            raise DataError("the cells' offsets are wrong", where=where, found="a cell of less than 0 points")
        check_indices(along, len(points[-1]), where)
        kinds = piece.array("Cells", "types", count).reshape(-1) if count else np.zeros(0, np.uint8)
        arrays = piece.arrays("CellData", count)
        ghost = arrays.pop(GHOST, np.zeros(count, np.uint8)).reshape(count, -1)[:, 0]
        keep = np.flatnonzero(ghost & DUPLICATE == 0)
        lengths.append(own[keep])
        corners.append(along[np.repeat(ghost & DUPLICATE == 0, own)] + begin)
        types.append(kinds[keep])
        of_cells.append({name: array[keep] for name, array in arrays.items()})
        of_points.append(piece.arrays("PointData", len(points[-1])))
        of_points[-1].pop(GHOST, None)
        begin += len(points[-1])
    offsets = np.append(0, np.cumsum(np.concatenate(lengths)))
    parts = np.concatenate(points), np.concatenate(types), offsets, np.concatenate(corners)
    return grid_of_cells(*parts, joined(of_points), joined(of_cells), where)
