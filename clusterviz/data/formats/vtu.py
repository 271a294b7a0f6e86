"""VTK's unstructured grids in XML (.vtu); see `clusterviz.data.vtk_xml`. `grid_files.py` reads their lists (.pvtu).

Pieces of a file are joined, without ghost cells; of arrays, those that all pieces have are kept.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import check_indices
from clusterviz.data.unstructured import Polyhedra, UnstructuredGrid, joined_grids
from clusterviz.data.vtk_cells import POLYHEDRON, grid_of_cells
from clusterviz.data.vtk_xml import XmlPiece, xml_pieces


def read_vtu(path: Path) -> UnstructuredGrid:
    grids = [_grid(piece, str(path)) for piece in xml_pieces(path, "UnstructuredGrid")]
    return grids[0] if len(grids) == 1 else joined_grids(grids, str(path))


def _grid(piece: XmlPiece, where: str) -> UnstructuredGrid:
    points, count = piece.points(), piece.count("NumberOfCells")
    ends, corners = piece.cells("Cells", count)
    check_indices(corners, len(points), where)
    types = piece.array("Cells", "types", count).reshape(-1) if count else np.zeros(0, np.uint8)
    of_cells = piece.arrays("CellData", count)
    of_points = piece.arrays("PointData", len(points))
    polyhedra = _polyhedra(piece, types)
    return grid_of_cells(points, types, np.append(0, ends), corners, of_points, of_cells, where, polyhedra)


def _polyhedra(piece: XmlPiece, types: NDArray[Any]) -> Polyhedra:
    """Return the polyhedra of a piece, in VTK's form from 9.4 on, or as streams."""
    own = np.flatnonzero(types == POLYHEDRON)
    if not len(own):
        return Polyhedra.of_streams(np.zeros(0, np.int64), own)

    def load(name: str, count: int) -> NDArray[np.int64]:
        return piece.array("Cells", name, count).astype(np.int64).reshape(-1)

    if piece.has("Cells", "faceoffsets"):
        ends = load("faceoffsets", len(types))[own]
        return Polyhedra.of_streams(load("faces", int(ends.max())), np.append(0, ends[:-1]))
    ends = load("polyhedron_offsets", len(types))
    faces = load("polyhedron_to_faces", int(ends[-1]))
    face_ends = load("face_offsets", int(faces.max(initial=-1)) + 1)
    owners = np.repeat(np.arange(len(own)), np.diff(ends, prepend=0)[own])
    sizes = np.diff(face_ends, prepend=0)[faces]
    return Polyhedra(len(own), owners, face_ends[faces] - sizes, sizes, load("face_connectivity", int(face_ends[-1])))
