"""VTK's polygonal data in XML (.vtp): polygons, strips, lines and vertices; see `clusterviz.data.vtk_xml`.

Several pieces are joined; of arrays, those that all pieces have are kept. Lines can be written.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import Geometry, Lines, joined_arrays
from clusterviz.data.vtk_polydata import SECTIONS, Cells, polydata
from clusterviz.data.vtk_xml import XmlPiece, xml_pieces
from clusterviz.image.replace import replacing


def read_vtp(path: Path) -> Geometry:
    pieces = xml_pieces(path, "PolyData")
    points = [piece.points() for piece in pieces]
    cells: dict[str, Cells] = {}
    for section in SECTIONS:
        offsets, indices, cell_count, point_count = [np.zeros(1, np.int64)], [], 0, 0
        for piece, own in zip(pieces, points, strict=True):
            begins, along = piece.cells(section, piece.count(f"NumberOf{section}"))
            offsets.append(begins + cell_count)
            indices.append(along + point_count)
            cell_count, point_count = cell_count + len(along), point_count + len(own)
        cells[section] = np.concatenate(offsets), np.concatenate(indices)
    # VTK numbers the cells piece by piece; here the sections come first.
    order = np.concatenate([_cell_numbers(piece, section) for section in SECTIONS for piece in pieces])
    totals = [sum(piece.count(f"NumberOf{section}") for section in SECTIONS) for piece in pieces]
    of_cells = _joined([piece.arrays("CellData", total) for piece, total in zip(pieces, totals, strict=True)])
    of_points = _joined([piece.arrays("PointData", len(own)) for piece, own in zip(pieces, points, strict=True)])
    of_cells = {name: array[order] for name, array in of_cells.items()}
    return polydata(np.concatenate(points), cells, of_points, of_cells, str(path))


def _cell_numbers(piece: XmlPiece, section: str) -> NDArray[np.int64]:
    """Return the numbers of the section's cells in the file's cell data."""
    begin = sum(piece.count(f"NumberOf{each}", before=True) for each in SECTIONS)
    begin += sum(piece.count(f"NumberOf{each}") for each in SECTIONS[: SECTIONS.index(section)])
    return np.arange(begin, begin + piece.count(f"NumberOf{section}"))


def _joined(pieces: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Return the arrays that all pieces with tuples have."""
    return joined_arrays([piece for piece in pieces if any(map(len, piece.values()))] or pieces[:1])


def write_vtp(path: str | Path, lines: Lines) -> None:
    """Write lines with their arrays as one piece, binary, not compressed.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    text, body, begin = list[str](), list[bytes](), 0

    def note(name: str, array: NDArray[Any]) -> str:
        nonlocal begin
        array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        kind = {"f": "Float", "i": "Int", "u": "UInt"}[array.dtype.kind] + str(8 * array.dtype.itemsize)
        parts = array.shape[1] if array.ndim > 1 else 1
        tag = f'<DataArray type="{kind}" Name="{escape(name)}" NumberOfComponents="{parts}" format="appended" '
        body.extend((array.nbytes.to_bytes(8, "little"), array.tobytes()))
        begin, offset = begin + 8 + array.nbytes, begin
        return f'{tag}offset="{offset}"/>'

    count = len(lines.offsets) - 1
    connectivity, offsets = np.arange(len(lines.points), dtype=np.int64), lines.offsets[1:].astype(np.int64)
    sections = (
        ("Points", {"Points": lines.points}),
        ("Lines", {"connectivity": connectivity, "offsets": offsets}),
        ("PointData", lines.point_attributes),
        ("CellData", lines.line_attributes),
    )
    text += [f"<{tag}>{''.join(note(*each) for each in arrays.items())}</{tag}>" for tag, arrays in sections]
    head = '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64"><PolyData>'
    head += f'<Piece NumberOfPoints="{len(lines.points)}" NumberOfVerts="0" NumberOfLines="{count}" '
    head += f'NumberOfStrips="0" NumberOfPolys="0">{"".join(text)}</Piece></PolyData>'
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(f'{head}<AppendedData encoding="raw">_'.encode())
        file.writelines(body)
        file.write(b"</AppendedData></VTKFile>\n")
