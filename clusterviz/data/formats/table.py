"""Tables of points, and of lines: text (.csv, .tsv, .txt, .xyz) and NumPy files (.npy, .npz).

The columns x, y, z (or `Points:0` to `Points:2`, as ParaView writes them) are positions, or x and y alone, at z = 0;
without names the first three. Other columns of numbers are attributes, and three whose names end in :0 to :2, or in _x
to _z, are a vector. Fields may be in quotes; an empty one is NaN. An .xyz file that begins with a number alone holds
atoms: their number, a comment, and a line each of element and position.
Rows of equal `line`, one after another, are a polyline. A .npy file is an array (n, 3 or more), or a structured one
with fields x, y, z. A .npz file has `vertices` (n, 3), `faces` (m, 3), and further arrays of n or m; or `arr_0` to
`arr_2`: vertices (z, y, x), faces and values, as napari has them.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import readable
from clusterviz.data.formats.molecule import atoms_of_xyz
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.errors import DataError

POSITIONS = (("x", "y", "z"), ("points:0", "points:1", "points:2"), ("x", "y"))
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)
VECTORS = ((":0", ":1", ":2"), ("_x", "_y", "_z"))


def read_table(path: Path) -> Geometry:
    """Read a table in text; the separator is a comma, semicolon, tab or blanks. Lines from # on are comments."""
    where = str(path)
    with readable(path), path.open(encoding="utf-8-sig") as file:
        lines = (line for line in map(_without_comment, file) if line.strip())
        first = next(lines, "")
        if path.suffix.lower() == ".xyz" and first.strip().isdecimal():
            return atoms_of_xyz(file, int(first), where)
        separator = next((mark for mark in (",", ";", "\t") if mark in first), None)
        names, rows = _fields(first, separator), list(lines)
    if names and all(NUMBER.fullmatch(name) for name in names):
        rows, names = [first, *rows], [f"column {n}" for n in range(len(names))]
        names[:3] = POSITIONS[0][: len(names)]
    kinds = _first_entries(rows, len(names), separator, where)
    numeric = [n for n, entry in enumerate(kinds) if not rows or NUMBER.fullmatch(entry)]
    columns = np.empty((0, len(numeric)))
    if rows:
        try:
            columns = np.loadtxt(rows, np.float64, **_dialect(separator, numeric))
        except ValueError:  # empty fields
            columns = np.loadtxt(rows, np.float64, **_dialect(separator, numeric), converters=_number)
    return _geometry({names[n]: column for n, column in zip(numeric, columns.T, strict=True)}, where)


def _dialect(separator: str | None, numeric: Sequence[int]) -> dict[str, Any]:
    return {"delimiter": separator, "usecols": numeric, "quotechar": '"', "comments": None, "ndmin": 2}


def _number(field: str) -> float:
    return float(field) if field.strip() else float("nan")


def _without_comment(line: str) -> str:
    """Return a line up to a # that is not in quotes."""
    if "#" not in line:
        return line
    return re.match(r'(?:[^"#]|"[^"]*"|")*?(?=#|$)', line.rstrip("\n"))[0]  # type: ignore[index]


def _fields(line: str, separator: str | None) -> list[str]:
    words = (
        next(csv.reader([line.strip(" \r\n")], delimiter=separator, skipinitialspace=True))
        if separator
        else line.split()
    )
    return [word.strip().strip("\"'") for word in words]


def _first_entries(rows: Sequence[str], count: int, separator: str | None, where: str) -> list[str]:
    found = [""] * count
    for number, row in enumerate(rows):
        fields = _fields(row, separator)
        if number == 0 and len(fields) != count:
            raise DataError("rows of different lengths", where=where, found=f"{count} columns, then {len(fields)}")
        found = [known or field for known, field in zip(found, fields, strict=False)]
        if all(found):
            break
    return found


def read_npy_table(path: Path) -> Geometry:
    where = str(path)
    array = np.load(path, mmap_mode="r", allow_pickle=False)  # the map refuses what the file is too short for
    if array.dtype.names:
        return _geometry({name: np.array(array[name]) for name in array.dtype.names}, where)
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "iuf":
        found = f"{array.dtype} {array.shape}"
        raise DataError("not points", where=where, found=found, allowed="numbers (n, 3 or more)")
    names = [*POSITIONS[0], *(f"column {n}" for n in range(3, array.shape[1]))]
    return _geometry({name: np.array(column) for name, column in zip(names, array.T, strict=True)}, where)


def is_npy_table(path: Path) -> bool:
    """Return whether a .npy file has fields x, y, z: else it is a volume unless the scene says otherwise."""
    return {"x", "y", "z"} <= set(np.load(path, mmap_mode="r", allow_pickle=False).dtype.names or ())


def read_npz_mesh(path: Path) -> Geometry:
    where = str(path)
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    if "vertices" in arrays and "faces" in arrays:
        vertices, faces = arrays.pop("vertices"), arrays.pop("faces")
    elif "arr_0" in arrays and "arr_1" in arrays:
        # Reversing the axes mirrors space, which turns the triangles round.
        vertices, faces = arrays.pop("arr_0")[:, ::-1], arrays.pop("arr_1")[:, ::-1]
        arrays = {"values": arrays["arr_2"]} if "arr_2" in arrays else {}
    else:
        allowed = "vertices and faces, or arr_0 and arr_1"
        raise DataError("no mesh", where=where, found=", ".join(arrays), allowed=allowed)
    of_vertices = {name: array for name, array in arrays.items() if array.shape[:1] == vertices.shape[:1]}
    of_faces = {n: a for n, a in arrays.items() if a.shape[:1] == faces.shape[:1] and n not in of_vertices}
    vertices = np.ascontiguousarray(vertices, np.promote_types(vertices.dtype, np.float32))
    return Geometry(mesh=Mesh(where, vertices, faces, of_vertices, of_faces))


def is_npz_mesh(path: Path) -> bool:
    """Return whether a .npz file holds a mesh, by the names and shapes of its arrays."""
    with np.load(path, allow_pickle=False) as archive:
        names = set(archive.files)
        if {"arr_0", "arr_1"} <= names <= {"arr_0", "arr_1", "arr_2"}:
            return all(archive[name].ndim == 2 and archive[name].shape[1] == 3 for name in ("arr_0", "arr_1"))
        return {"vertices", "faces"} <= names


def _geometry(columns: dict[str, NDArray[Any]], where: str) -> Geometry:
    by_name = {name.lower(): name for name in columns}
    found = next((names for names in POSITIONS if all(name in by_name for name in names)), None)
    if not found:
        raise DataError("no positions", where=where, found=", ".join(columns), allowed="columns x, y, z of numbers")
    stacked = np.stack([columns.pop(by_name[name]) for name in found], axis=1)
    stacked = np.pad(stacked, ((0, 0), (0, 3 - len(found))))
    positions = np.ascontiguousarray(stacked, np.promote_types(stacked.dtype, np.float32))
    number = columns.pop(by_name.get("line", ""), None)
    for ends in VECTORS:
        for stem in [name.removesuffix(ends[0]) for name in columns if name.endswith(ends[0])]:
            names = [stem + end for end in ends]
            if stem and stem not in columns and all(name in columns for name in names):
                columns[stem] = np.stack([columns.pop(name) for name in names], axis=1)
    if number is None:
        return Geometry(points=Points(where, positions, columns))
    begins = np.flatnonzero(np.concatenate([[True], number[1:] != number[:-1]])) if len(number) else np.empty(0, int)
    offsets = np.append(begins, len(number)) if len(number) else np.zeros(1, np.int64)
    return Geometry(lines=Lines(where, positions, offsets, columns))
