"""Legacy VTK files (.vtk), ASCII or BINARY (big endian): images and polygonal data.

Point data of images (DATASET STRUCTURED_POINTS, RECTILINEAR_GRID) lies on the samples; cell data is point data at the
cells' centres. Uneven coordinates are those of `clusterviz.data.rectilinear`.
Without a name the first SCALARS are taken, or the only array; of vectors and tensors, `channel` is one component.
Binary images are read box by box. Polygonal data (POLYDATA) is read as a whole, from files of any version.

References
----------
VTK File Formats, "Simple Legacy Formats", https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, select
from clusterviz.data.files import readable, require_file
from clusterviz.data.formats.vtp import Cells, polydata
from clusterviz.data.geometry import Attributes, Geometry
from clusterviz.data.header import check_packed, check_size, stated_numbers
from clusterviz.data.source import Grid, Source
from clusterviz.data.storage import (
    FileBytes,
    FileRange,
    StridedSource,
    numbers_from_text,
    numbers_in_text,
    slab_source,
)
from clusterviz.data.unstructured import Polyhedra, UnstructuredGrid
from clusterviz.data.vtk_cells import POLYHEDRON, grid_of_cells
from clusterviz.data.vtk_image import ImageArray, image_grid, open_image, rectilinear
from clusterviz.errors import DataError

TYPES = {"char": "i1", "unsigned_char": "u1", "short": "i2", "unsigned_short": "u2", "int": "i4", "unsigned_int": "u4"}
TYPES |= {"long": "i8", "unsigned_long": "u8", "vtktypeint64": "i8", "vtktypeuint64": "u8", "vtkidtype": "i4"}
TYPES |= {"float": "f4", "double": "f8"}
COORDINATES = ("X_COORDINATES", "Y_COORDINATES", "Z_COORDINATES")
CELLS = {"VERTICES": "Verts", "LINES": "Lines", "POLYGONS": "Polys", "TRIANGLE_STRIPS": "Strips", "CELLS": "Cells"}
VECTORS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}
MAX_LINE, MAX_ARRAYS = 1 << 16, 1 << 12


@dataclass(frozen=True)
class VtkArray(ImageArray):
    """Array of a legacy VTK file, of `tuples` tuples at bytes `begin` to `end`."""

    kind: str = ""
    begin: int = 0
    end: int = 0
    tuples: int = 0


@dataclass
class _Scan:
    """One pass over the keywords of a file; samples are skipped."""

    file: Any
    where: str
    size: int
    binary: bool = False
    numbers: dict[str, list[float]] = field(default_factory=dict)
    arrays: list[VtkArray] = field(default_factory=list)
    on_cells: bool | None = None
    tuples: int = 0
    points: VtkArray | None = None
    coordinates: dict[str, VtkArray] = field(default_factory=dict)
    cells: dict[str, list[VtkArray]] = field(default_factory=dict)
    types: VtkArray | None = None

    def line(self) -> list[str]:
        """Return the words of the next line that is not blank; none at the end of the file."""
        while text := self.file.readline(MAX_LINE):
            words = text.decode("utf-8", "replace").split()
            if words:
                return list(words)
        return []

    def dataset(self) -> list[str]:
        self.file.readline(MAX_LINE)  # "# vtk DataFile Version 3.0", then a title
        self.file.readline(MAX_LINE)
        form, kind = self.line()[:1], self.line()
        if form not in (["ASCII"], ["BINARY"]):
            raise DataError("neither text nor binary", where=self.where, found=form, allowed="ASCII, BINARY")
        self.binary = form == ["BINARY"]
        while kind[:1] in (["FIELD"], ["METADATA"]):  # of the file, before the dataset
            if kind[0] == "FIELD":
                self.fields(self.counts(kind[2:3], 1)[0])
            else:
                self.metadata()
            kind = self.line()
        return kind

    def run(self) -> None:
        while words := self.line():
            key, rest = words[0].upper(), words[1:]
            if key in ("DIMENSIONS", "ORIGIN", "SPACING", "ASPECT_RATIO"):
                self.numbers[key] = stated_numbers(" ".join(rest), key, 3, self.where).tolist()
            elif key == "POINTS":
                self.points = self.skipped("POINTS", self.word(rest, 1), 3, self.counts(rest[:1], 1)[0])
            elif key in COORDINATES:
                self.coordinates[key] = self.skipped(key, self.word(rest, 1), 1, self.counts(rest[:1], 1)[0])
            elif key in CELLS:
                self.cells[CELLS[key]] = self.cell_arrays(*self.counts(rest, 2))
            elif key == "CELL_TYPES":
                self.types = self.skipped("CELL_TYPES", "int", 1, self.counts(rest[:1], 1)[0])
            elif key in ("POINT_DATA", "CELL_DATA"):
                self.on_cells, (self.tuples,) = key == "CELL_DATA", self.counts(rest, 1)
            elif key == "SCALARS":
                kind, components = self.word(rest, 1), self.counts(rest[2:3] or ["1"], 1)[0]
                lookup = self.file.tell()
                if self.line()[:1] != ["LOOKUP_TABLE"]:
                    self.file.seek(lookup)
                self.array(rest[0], True, kind, components, self.tuples)
            elif key in VECTORS:
                self.array(self.word(rest, 0), False, self.word(rest, 1), VECTORS[key], self.tuples)
            elif key == "TEXTURE_COORDINATES":
                self.array(self.word(rest, 0), False, self.word(rest, 2), self.counts(rest[1:2], 1)[0], self.tuples)
            elif key == "COLOR_SCALARS":
                kind = "unsigned_char" if self.binary else "float"
                self.array(self.word(rest, 0), False, kind, self.counts(rest[1:2], 1)[0], self.tuples)
            elif key == "LOOKUP_TABLE":
                self.skip("unsigned_char" if self.binary else "float", 4 * self.counts(rest[1:2], 1)[0])
            elif key == "FIELD":
                self.fields(self.counts(rest[1:2], 1)[0])
            elif key == "METADATA":
                self.metadata()
            else:
                raise DataError("truncated, or not understood", where=self.where, found=f"the line {words[0]!r}")

    def fields(self, count: int) -> None:
        for _ in range(min(count, MAX_ARRAYS)):
            words = self.line()
            if words[:1] == ["METADATA"]:
                self.metadata()
                words = self.line()
            components, tuples = self.counts(words[1:3], 2)
            self.array(self.word(words, 0), False, self.word(words, 3), components, tuples)

    def metadata(self) -> None:
        while self.file.readline(MAX_LINE).strip():
            pass

    def cell_arrays(self, count: int, size: int) -> list[VtkArray]:
        """Return where the cells lie: offsets and indices, or, before version 5, each cell's length and indices."""
        begin, words = self.file.tell(), self.line()
        if words[:1] != ["OFFSETS"]:
            self.file.seek(begin)
            return [self.skipped("cells", "int", 1, size)]
        offsets = self.skipped("OFFSETS", self.word(words, 1), 1, count)
        words = self.line()
        if words[:1] != ["CONNECTIVITY"]:
            raise DataError("truncated: no CONNECTIVITY", where=self.where, found=" ".join(words))
        return [offsets, self.skipped("CONNECTIVITY", self.word(words, 1), 1, size)]

    def skipped(self, name: str, kind: str, components: int, tuples: int) -> VtkArray:
        begin = self.file.tell()
        self.skip(kind, components * tuples)
        end = self.file.tell()
        return VtkArray(name, bool(self.on_cells), False, components, None, kind.lower(), begin, end, tuples)

    def array(self, name: str, active: bool, kind: str, components: int, tuples: int) -> None:
        found = self.skipped(unquote(name), kind, components, tuples)
        if self.on_cells is not None:
            self.arrays.append(replace(found, active=active))
        if len(self.arrays) > MAX_ARRAYS:
            raise DataError("too many arrays", where=self.where, allowed=f"at most {MAX_ARRAYS}")

    def skip(self, kind: str, count: int) -> None:
        """Skip `count` numbers, or as many strings, one a line."""
        begin = self.file.tell()
        if kind.lower() == "string":
            check_packed(self.size - begin, count, "text", self.where)
            for _ in range(count):
                self.skip_string()
            return
        if self.binary:
            bits = 1 if kind.lower() == "bit" else 8 * np.dtype(self.type_of(kind)).itemsize
            end = begin + -(-count * bits // 8)
            check_size(self.size, end, self.where)
            self.file.seek(end)
            return
        check_packed(self.size - begin, count, "text", self.where)
        while count > 0:
            words = self.file.readline(MAX_LINE).split()
            if not words and self.file.tell() >= self.size:
                raise DataError(f"the file ends {count} numbers early", where=self.where)
            count -= len(words)

    def skip_string(self) -> None:
        """Skip a line, or a binary string with its length, whose first two bits give the length's size."""
        if not self.binary:
            self.file.readline(MAX_LINE)
            return
        first = self.file.read(1)
        further = {3: 0, 2: 1, 1: 3, 0: 7}[first[0] >> 6] if first else 0
        length = int.from_bytes(bytes([first[0] & 63 if first else 0]) + self.file.read(further), "big")
        check_size(self.size, self.file.tell() + length, self.where)
        self.file.seek(length, 1)

    def type_of(self, kind: str) -> str:
        if kind.lower() not in TYPES:
            raise DataError("unknown type", where=self.where, found=kind, allowed=", ".join(TYPES))
        return TYPES[kind.lower()]

    def word(self, words: list[str], index: int) -> str:
        if len(words) <= index:
            raise DataError("truncated: a line lacks words", where=self.where, found=" ".join(words))
        return words[index]

    def counts(self, words: list[str], count: int) -> list[int]:
        if len(words) != count or not all(word.isdecimal() and len(word) < 19 for word in words):
            raise DataError("not a number", where=self.where, found=" ".join(words) or "nothing", allowed="0 or more")
        return [int(word) for word in words]


def _scan(path: Path, datasets: Sequence[str], noun: str) -> _Scan:
    """Return the keywords of a file with one of the given kinds of dataset."""
    size = require_file(path, (b"# vtk DataFile",))
    with readable(path), path.open("rb") as file:
        scan = _Scan(file, str(path), size)
        kind = scan.dataset()
        if kind[:1] != ["DATASET"] or kind[1:] not in [[each] for each in datasets]:
            allowed = f"DATASET {' or '.join(datasets)}"
            raise DataError(f"not {noun}", where=str(path), found=" ".join(kind), allowed=allowed)
        scan.run()
    if kind[1:] == ["RECTILINEAR_GRID"] and len(scan.coordinates) != 3:
        raise DataError("no coordinates", where=str(path), found=[*scan.coordinates], allowed=", ".join(COORDINATES))
    return scan


def is_polydata(path: Path) -> bool:
    return _kind_of(path) == ["POLYDATA"]


def _kind_of(path: Path) -> list[str]:
    size = require_file(path, (b"# vtk DataFile",))
    with readable(path), path.open("rb") as file:
        return _Scan(file, str(path), size).dataset()[1:]


def open_vtk(path: Path, subset: Subset) -> Source:
    scan = _scan(path, ("STRUCTURED_POINTS", "RECTILINEAR_GRID"), "image data")
    chosen, source = open_image(scan.arrays, subset, path, "array", partial(_source_of, path, scan))
    if not scan.coordinates:
        found: Source = source
        return found
    where, lines = f"{path}:{chosen.name}", [_load(path, scan, scan.coordinates[key]) for key in COORDINATES]
    if [len(line) for line in lines] != scan.numbers["DIMENSIONS"]:
        lengths, allowed = f"{[len(line) for line in lines]}", scan.numbers["DIMENSIONS"]
        raise DataError("the coordinates do not fit", where=where, found=lengths, allowed=allowed)
    return rectilinear(source, lines, chosen.on_cells, subset.spaced, where)


def _source_of(path: Path, scan: _Scan, array: VtkArray, subset: Subset) -> StridedSource:
    where = f"{path}:{array.name}"
    stored = np.dtype(scan.type_of(array.kind)).newbyteorder(">" if scan.binary else "=")
    grid = _grid_of(scan, array.on_cells, where)
    slab = select((*grid.shape_zyx, array.components), "ZYXC", subset, where)
    begin, end, count = array.begin, array.end, slab.samples
    if not scan.binary:
        return slab_source(where, slab, grid, numbers_in_text(path, begin, end, stored, count, where), stored)
    check_size(end - begin, count * stored.itemsize, where, exact=True)
    return slab_source(where, slab, grid, FileBytes([FileRange(path, begin, end - begin)]), stored)


def _grid_of(scan: _Scan, on_cells: bool, where: str) -> Grid:
    if "DIMENSIONS" not in scan.numbers:
        raise DataError("no DIMENSIONS", where=where, allowed="DIMENSIONS nx ny nz")
    points = np.array(scan.numbers["DIMENSIONS"], np.int64)
    steps = np.diag(scan.numbers.get("SPACING") or scan.numbers.get("ASPECT_RATIO") or [1.0, 1.0, 1.0])
    origin = np.array(scan.numbers.get("ORIGIN", [0.0, 0.0, 0.0]))
    return image_grid(points, steps, origin, np.zeros(3), on_cells, where)


def read_polydata(path: Path) -> Geometry:
    scan = _scan(path, ("POLYDATA",), "polygonal data")
    points, cells, of_points, of_cells = _parts(path, scan)
    cells.pop("Cells", None)
    return polydata(points, cells, of_points, of_cells, str(path))


def is_unstructured(path: Path) -> bool:
    return _kind_of(path) == ["UNSTRUCTURED_GRID"]


def read_unstructured(path: Path) -> UnstructuredGrid:
    where, scan = str(path), _scan(path, ("UNSTRUCTURED_GRID",), "an unstructured grid")
    points, cells, of_points, of_cells = _parts(path, scan)
    if (scan.types is None) != ("Cells" not in cells):
        raise DataError("no cells", where=where, allowed="CELLS and CELL_TYPES")
    # VTK leaves both out of a piece without cells.
    types = np.zeros(0, np.int32) if scan.types is None else _load(path, scan, scan.types)
    offsets, corners = cells.get("Cells", (np.zeros(1, np.int64), np.zeros(0, np.int64)))
    if len(offsets) != len(types) + 1:
        raise DataError("the cells' offsets are wrong", where=where, found=len(offsets), allowed=len(types) + 1)
    polyhedra = Polyhedra.of_streams(corners, offsets[:-1][types == POLYHEDRON])
    return grid_of_cells(points, types, offsets, corners, of_points, of_cells, where, polyhedra)


def _parts(path: Path, scan: _Scan) -> tuple[NDArray[Any], dict[str, Cells], Attributes, Attributes]:
    if scan.points is None:
        raise DataError("no POINTS", where=str(path), allowed="POINTS n type")
    points = _load(path, scan, scan.points).reshape(-1, 3)
    cells = {key: _cells([_load(path, scan, a) for a in arrays], str(path)) for key, arrays in scan.cells.items()}
    usable = [a for a in scan.arrays if a.kind in TYPES and a.components]
    of_points, of_cells = ({a.name: _load(path, scan, a) for a in usable if a.on_cells == on} for on in (False, True))
    return points, cells, of_points, of_cells


def _load(path: Path, scan: _Scan, array: VtkArray) -> NDArray[Any]:
    """Return an array (tuples,), or (tuples, components) if there are several components."""
    where, count = f"{path}:{array.name}", array.tuples * array.components
    data = FileBytes([FileRange(path, array.begin, array.end - array.begin)]).read_at(0, array.end - array.begin)
    stored = np.dtype(scan.type_of(array.kind)).newbyteorder(">" if scan.binary else "=")
    numbers = data if scan.binary else numbers_from_text(data, stored, count, where)
    check_size(len(numbers), count * stored.itemsize, where)
    found = np.frombuffer(numbers, stored, count).astype(stored.newbyteorder("="))
    return found if array.components == 1 else found.reshape(array.tuples, array.components)


def _cells(arrays: list[NDArray[Any]], where: str) -> Cells:
    """Return offsets and indices of cells, also from lengths and indices in one array."""
    if len(arrays) == 2:
        offsets = arrays[0] if len(arrays[0]) else np.zeros(1)  # no cells at all
        return offsets.astype(np.int64), arrays[1].astype(np.int64)
    mixed = arrays[0].astype(np.int64)
    step = int(mixed[0]) + 1 if len(mixed) else 1
    if step > 0 and len(mixed) % step == 0 and (mixed[::step] == step - 1).all():  # cells of one length
        rows = mixed.reshape(-1, step)
        return np.arange(len(rows) + 1) * (step - 1), rows[:, 1:].ravel()
    at, begins = 0, list[int]()
    while at < len(mixed):
        length = int(mixed[at])
        if not 0 <= length < len(mixed) - at:
            raise DataError("a cell has an impossible length", where=where, found=length)
        begins.append(at)
        at += 1 + length
    keep = np.ones(len(mixed), bool)
    keep[begins] = False
    return np.append(np.array(begins, np.int64) - np.arange(len(begins)), keep.sum()), mixed[keep]
