"""VTK's polygonal data in XML (.vtp): polygons, strips, lines and vertices; see `clusterviz.data.vtk_xml`.

Several pieces are joined; of arrays, those that all pieces have are kept.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import require_file
from clusterviz.data.geometry import Geometry
from clusterviz.data.vtk_polydata import SECTIONS, Cells, polydata
from clusterviz.data.vtk_xml import TYPES, XmlArray, XmlLayout, load_array, scan_xml
from clusterviz.errors import DataError

COUNTS = ("NumberOfPoints", "NumberOfVerts", "NumberOfLines", "NumberOfPolys", "NumberOfStrips")


def read_vtp(path: Path) -> Geometry:
    """Read a .vtp file.

    Raises
    ------
    DataError
        Not such a file, damaged or truncated, counts that do not fit, or indices out of range.
    """
    size = require_file(path)
    layout = scan_xml(path, "PolyData")
    if not layout.pieces:
        raise DataError("no piece", where=str(path), allowed="<Piece …>")
    pieces = [_Piece(path, size, layout, number) for number in range(len(layout.pieces))]
    points = np.concatenate([piece.points for piece in pieces])
    cells: dict[str, Cells] = {}
    for section in SECTIONS:
        offsets, indices, cell_count, point_count = [np.zeros(1, np.int64)], [], 0, 0
        for piece in pieces:
            begins, along = piece.cells(section)
            offsets.append(begins + cell_count)
            indices.append(along + point_count)
            cell_count, point_count = cell_count + len(along), point_count + len(piece.points)
        cells[section] = np.concatenate(offsets), np.concatenate(indices)
    # VTK numbers the cells piece by piece; here the sections come first.
    order = np.concatenate([piece.cell_numbers(section) for section in SECTIONS for piece in pieces])
    of_cells = {name: array[order] for name, array in _joined([piece.arrays("CellData") for piece in pieces]).items()}
    return polydata(points, cells, _joined([piece.arrays("PointData") for piece in pieces]), of_cells, str(path))


class _Piece:
    """One piece of the dataset; `begin` is the number of cells before it."""

    def __init__(self, path: Path, size: int, layout: XmlLayout, number: int) -> None:
        self.path, self.size, self.layout, self.number = path, size, layout, number
        self.counts = {key: self._count(number, key) for key in COUNTS}
        self.begin = sum(self._count(before, key) for before in range(number) for key in COUNTS[1:])
        found = self._find("Points")
        if self.counts["NumberOfPoints"] and (not found or found[0].components != 3):
            raise DataError("a piece has no points", where=str(path), allowed="Points of three components")
        self.points = self._load(found[0], self.counts["NumberOfPoints"]) if found else np.empty((0, 3), np.float32)
        self.points = self.points.reshape(-1, 3)

    def _count(self, number: int, key: str) -> int:
        text = self.layout.pieces[number].get(key, "0").strip()
        if not text.isdecimal() or len(text) > 18:
            raise DataError(f"impossible {key}", where=str(self.path), found=repr(text), allowed="0 or more")
        return int(text)

    def _find(self, section: str, name: str | None = None) -> list[XmlArray]:
        mine = [each for each in self.layout.arrays if each.piece == self.number and each.section == section]
        return [each for each in mine if name in (None, each.name)]

    def _load(self, array: XmlArray, tuples: int) -> NDArray[Any]:
        return load_array(self.path, self.size, self.layout, array, tuples)

    def cells(self, section: str) -> Cells:
        """Return the ends of the section's cells (without the 0 at the beginning), and the indices of their points."""
        count = self.counts[f"NumberOf{section}"]
        ends, along = self._find(section, "offsets"), self._find(section, "connectivity")
        if not count:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        if not ends or not along:
            raise DataError(f"{section} lack an array", where=str(self.path), allowed="connectivity and offsets")
        offsets = self._load(ends[0], count).astype(np.int64).reshape(-1)
        if len(offsets) != count or not 0 <= offsets[-1] < 1 << 60:
            raise DataError(f"the offsets of {section} are wrong", where=str(self.path), found=offsets[-1:].tolist())
        return offsets, self._load(along[0], int(offsets[-1])).astype(np.int64).reshape(-1)

    def cell_numbers(self, section: str) -> NDArray[np.int64]:
        """Return the numbers of the section's cells in the file's cell data."""
        begin = self.begin
        for each in SECTIONS[: SECTIONS.index(section)]:
            begin += self.counts[f"NumberOf{each}"]
        return np.arange(begin, begin + self.counts[f"NumberOf{section}"])

    def arrays(self, section: str) -> dict[str, NDArray[Any]]:
        """Return the arrays of numbers of PointData or CellData."""
        tuples = self.counts["NumberOfPoints"]
        if section == "CellData":
            tuples = sum(self.counts[key] for key in COUNTS[1:])
        numbers = [each for each in self._find(section) if each.attributes.get("type") in TYPES and each.components]
        return {each.name or f"array {number}": self._load(each, tuples) for number, each in enumerate(numbers)}


def _joined(pieces: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Return the arrays that all pieces with tuples have, one after another."""
    filled = [piece for piece in pieces if any(len(array) for array in piece.values())] or pieces[:1]
    names = [name for name in filled[0] if all(name in piece for piece in filled)]
    alike = [name for name in names if len({piece[name].shape[1:] for piece in filled}) == 1]
    return {name: np.concatenate([piece[name] for piece in filled]) for name in alike}
