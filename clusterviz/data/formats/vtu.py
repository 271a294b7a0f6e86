"""VTK's unstructured grids in XML (.vtu), and their parallel form (.pvtu); see `clusterviz.data.vtk_xml`.

Pieces are joined; of arrays, those that all pieces have are kept. Ghost cells of pieces (`vtkGhostType` 1) are dropped,
as another piece has them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import readable, require_file
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


def read_pvtu(path: Path) -> UnstructuredGrid:
    """Read all files that a .pvtu file names.

    Raises
    ------
    DataError
        Not such a file, a file is missing, or as of `read_vtu`.
    """
    pieces = [piece for source in piece_files(path) for piece in _pieces(source)]
    return _read(pieces, str(path))


def piece_files(path: Path) -> list[Path]:
    """Return the files that a .pvtu file names, in its order."""
    require_file(path)
    names, parser = list[str](), expat.ParserCreate()
    kind = list[str]()

    def start(tag: str, attributes: dict[str, str]) -> None:
        if tag == "VTKFile":
            kind.append(attributes.get("type", ""))
        elif tag == "Piece":
            names.append(attributes.get("Source", ""))

    parser.StartElementHandler = start
    with readable(path):
        content = path.read_bytes()
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise DataError(f"truncated or damaged XML: {error}", where=str(path)) from error
    if kind != ["PUnstructuredGrid"]:
        allowed = "VTKFile type PUnstructuredGrid"
        raise DataError("not a parallel unstructured grid", where=str(path), found=kind, allowed=allowed)
    if not names or not all(names):
        raise DataError("no pieces", where=str(path), allowed="<Piece Source=…>")
    return [path.parent / name for name in names]


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
