"""VTK's polygonal data (.vtp: polygons, strips, lines and vertices) and unstructured grids (.vtu) in XML.

Several pieces are joined, without ghost cells; of arrays, those that all pieces have are kept. Lines can be written.
See `clusterviz.data.vtk_xml`; `grid_files.py` reads lists of pieces (.pvtu).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.geometry import (
    Attributes,
    Geometry,
    Lines,
    Mesh,
    Points,
    check_attributes,
    check_indices,
    joined_arrays,
    triangulate,
    triangulate_strips,
)
from clusterviz.data.unstructured import Polyhedra, UnstructuredGrid, joined_grids
from clusterviz.data.vtk_cells import POLYHEDRON, grid_of_cells
from clusterviz.data.vtk_image import UNDRAWN_POINTS, drawn_cells, some_cells, split_ghosts
from clusterviz.data.vtk_xml import XmlPiece, xml_pieces
from clusterviz.errors import DataError
from clusterviz.image.replace import replacing

SECTIONS = ("Verts", "Lines", "Polys", "Strips")
"""Kinds of cells, in the order of their numbers."""
Cells = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Offsets (k + 1,), and indices of points: cell i has those at [offsets[i], offsets[i + 1])."""


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


def polydata(
    points: NDArray[np.floating], cells: Mapping[str, Cells], of_points: Attributes, of_cells: Attributes, where: str
) -> Geometry:
    """Return the geometry of polygonal data; a dataset without cells is points.

    Parameters
    ----------
    of_points, of_cells : arrays by name; cells are numbered in the order of `SECTIONS`
    """
    points = points.astype(np.promote_types(points.dtype, np.float32), copy=False)
    check_attributes(of_points, len(points), "points", where)
    of_points, point_bits = split_ghosts(of_points, len(points))
    empty = np.zeros(1, np.int64), np.zeros(0, np.int64)
    numbers, begin = {}, 0
    for section in SECTIONS:
        offsets, indices = cells.get(section, empty)
        if offsets[0] != 0 or offsets[-1] != len(indices) or (np.diff(offsets) < 0).any():
            allowed = f"offsets that rise from 0 to {len(indices)}"
            raise DataError(f"the offsets of {section} are wrong", where=where, found=offsets[[0, -1]], allowed=allowed)
        check_indices(indices, len(points), where)
        numbers[section] = np.arange(begin, begin + len(offsets) - 1)
        begin += len(offsets) - 1
    for name, array in of_cells.items():
        if len(array) != begin:
            raise DataError(f"the array {name} does not fit", where=where, found=len(array), allowed=f"{begin} cells")
    if not begin:
        is_drawn = point_bits & UNDRAWN_POINTS == 0
        return Geometry(points=Points(where, points[is_drawn], {n: a[is_drawn] for n, a in of_points.items()}))
    of_cells, bits = split_ghosts(of_cells, begin)
    if point_bits.any() or bits.any():
        cells = dict(cells)
        for section in cells:
            is_drawn = drawn_cells(*cells[section], bits[numbers[section]], point_bits)
            cells[section], numbers[section] = some_cells(*cells[section], is_drawn), numbers[section][is_drawn]
    found = []
    for section, cut in (("Polys", triangulate), ("Strips", triangulate_strips)):
        triangles, cell = cut(*cells.get(section, empty))
        found.append((triangles, numbers[section][cell]))
    triangles, cell = (np.concatenate(parts) for parts in zip(*found, strict=True))
    mesh = Mesh(where, points, triangles, of_points, {name: array[cell] for name, array in of_cells.items()})
    offsets, along = cells.get("Lines", empty)
    on_lines = {name: array[numbers["Lines"]] for name, array in of_cells.items()}
    lines = Lines(where, points[along], offsets, {name: array[along] for name, array in of_points.items()}, on_lines)
    begins, dots = cells.get("Verts", empty)
    cell = np.repeat(numbers["Verts"], np.diff(begins))
    on_dots = {name: array[cell] for name, array in of_cells.items()}
    verts = Points(where, points[dots], on_dots | {name: array[dots] for name, array in of_points.items()})
    has_polygons = len(numbers["Polys"]) + len(numbers["Strips"]) > 0
    return Geometry(
        mesh if has_polygons else None,
        lines if len(numbers["Lines"]) else None,
        verts if len(numbers["Verts"]) else None,
    )


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
