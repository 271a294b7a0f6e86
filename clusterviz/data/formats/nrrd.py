"""NRRD (.nrrd, and .nhdr with the data in other files), the format of 3D Slicer; pynrrd reads the header.

Encodings raw (any box, any size), gzip and bzip2 (in order of z) and ascii. The grid comes from `space directions` and
`space origin`, else from `spacings`, `axis mins`, `axis maxs` and `centerings`; the world is the file's `space`. Where
units differ, world units are that of x. An axis with one entry, such as a single component, is dropped. Other axes are
time or channels by their `kinds`; without these the slowest is time.
"""

from __future__ import annotations

import bz2
import gzip
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import nrrd
import numpy as np

from clusterviz.data.axes import Subset, select, unnamed_axes
from clusterviz.data.files import explained, readable, refuse_array, require_file
from clusterviz.data.header import axis_factors, check_packed, check_shape, make_grid
from clusterviz.data.source import Grid, Index
from clusterviz.data.storage import (
    FileBytes,
    Storage,
    StreamBytes,
    StridedSource,
    file_ranges,
    numbered_names,
    numbers_in_text,
    slab_source,
)
from clusterviz.errors import DataError

PACKINGS = {"gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2"}
DECODERS: dict[str, Callable[[Any], Any]] = {"gzip": gzip.open, "bzip2": bz2.open}
TYPES = {
    **dict.fromkeys(("signed char", "int8", "int8_t"), "i1"),
    **dict.fromkeys(("uchar", "unsigned char", "uint8", "uint8_t"), "u1"),
    **dict.fromkeys(("short", "short int", "signed short", "signed short int", "int16", "int16_t"), "i2"),
    **dict.fromkeys(("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"), "u2"),
    **dict.fromkeys(("int", "signed int", "int32", "int32_t"), "i4"),
    **dict.fromkeys(("uint", "unsigned int", "uint32", "uint32_t"), "u4"),
    **dict.fromkeys(("longlong", "long long", "long long int", "signed long long", "signed long long int"), "i8"),
    **dict.fromkeys(("int64", "int64_t"), "i8"),
    **dict.fromkeys(("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"), "u8"),
    "float": "f4",
    "double": "f8",
}
TEXTS = ("ascii", "text", "txt")
MAX_HEADER = 1 << 20


def open_nrrd(path: Path, subset: Subset) -> StridedSource:
    refuse_array(subset.array, path)
    where = str(path)
    header, listed, header_bytes = _read_header(path)
    stored = _stored_dtype(header, where)
    sizes = [int(n) for n in header["sizes"]]
    check_shape([min(sizes, default=0), 1, 1], where)
    kept = [axis for axis, n in enumerate(sizes) if n > 1 or len(sizes) <= 3]
    if len(kept) < 3 < len(sizes):  # thin volumes with a unit axis too many: the last three are space
        kept = list(range(len(sizes)))[-3:]
    kept.reverse()  # slowest first
    slab = select([sizes[axis] for axis in kept], _letters(header, kept, subset), subset, where)
    space = [axis for axis, index in zip(kept, slab.index, strict=True) if index is None]
    orientation = _orientation(str(header.get("space", "")))
    grid = replace(_grid_of(header, space[::-1], slab.shape_zyx, where), orientation=orientation)
    files = _data_files(header, listed, path)
    needed = slab.samples * stored.itemsize
    keep = max(slab.strides(stored.itemsize)[1])
    storage, begin = _storage(header, files or [path], 0 if files else header_bytes, needed, keep, where)
    return slab_source(where, slab, grid, storage, stored, begin)


def _orientation(space: str) -> str:
    """Return the letters of an anatomical space: LPS for "left-posterior-superior" and "LPS"."""
    letters = "".join(word[:1] for word in space.split("-")[:3]) if "-" in space else space[:3]
    return letters.upper() if letters.upper() in ("RAS", "LAS", "LPS") else ""


def _letters(header: Mapping[str, Any], axes: Sequence[int], subset: Subset) -> str:
    kinds = header.get("kinds")
    if kinds is None:
        return unnamed_axes([int(header["sizes"][axis]) for axis in axes], subset)
    letters = {"time": "T", **dict.fromkeys(("domain", "space", "none", "???", "stub"), "Z")}
    found = "".join(letters.get(str(kinds[axis]).lower(), "C") for axis in axes)
    return "TZZZ" if found == "ZZZZ" else found  # as ITK writes time


def _read_header(path: Path) -> tuple[dict[str, Any], list[str], int]:
    lines: list[bytes] = []
    listed: list[str] = []
    header_bytes = 0
    with readable(path), path.open("rb") as file:
        for line in iter(lambda: file.readline(1 << 16), b""):
            if not line.strip():
                break
            header_bytes += len(line)
            if header_bytes > MAX_HEADER:
                raise DataError("the header has no end", where=str(path), allowed=f"at most {MAX_HEADER} bytes")
            lines.append(line)
            if re.match(rb"data ?file: *LIST", line):
                names = file.read(MAX_HEADER).decode("utf-8", "replace").splitlines()
                listed = [name.strip() for name in names if name.strip()]
                break
        header_bytes = file.tell()
    with explained("the header cannot be read", path):
        header = dict(nrrd.read_header(lines))
        missing = {"type", "dimension", "sizes", "encoding"} - set(header)
        if missing or int(header["dimension"]) != len(header["sizes"]):
            raise ValueError(f"missing {sorted(missing)}" if missing else "sizes do not match dimension")
    return header, listed, header_bytes


def _stored_dtype(header: Mapping[str, Any], where: str) -> np.dtype[Any]:
    if header["type"] not in TYPES:
        found, allowed = f"type {header['type']}", "an integer or float type"
        raise DataError("not a scalar volume", where=where, found=found, allowed=allowed)
    stored: np.dtype[Any] = np.dtype(TYPES[header["type"]])
    if stored.itemsize > 1 and header["encoding"].lower() not in TEXTS:
        if header.get("endian") not in ("little", "big"):
            raise DataError("no byte order", where=where, found=header.get("endian"), allowed="endian: little or big")
        stored = stored.newbyteorder("<" if header["endian"] == "little" else ">")
    return stored


def _data_files(header: Mapping[str, Any], listed: Sequence[str], path: Path) -> list[Path]:
    """Return the data files of a detached header, slowest last; none for an attached one."""
    entry = str(header.get("data file", header.get("datafile", "")))
    names = list(listed) if listed else numbered_names(entry, str(path)) if entry else []
    if path.suffix.lower() == ".nhdr" and not names:
        raise DataError("a detached header needs a data file", where=str(path), allowed="data file: NAME")
    return [path.parent / name for name in names]


def _storage(
    header: Mapping[str, Any], files: list[Path], begin: int, needed: int, keep: int, where: str
) -> tuple[Storage, int]:
    encoding, stored = str(header["encoding"]).lower(), _stored_dtype(header, where)
    skip = int(header.get("byte skip", header.get("byteskip", 0)))
    sizes = [require_file(file) for file in files]
    begins = [_skip_lines(file, begin, int(header.get("line skip", header.get("lineskip", 0)))) for file in files]
    if encoding == "raw":
        return FileBytes(file_ranges(files, sizes, begins, skip, needed)), 0
    if len(files) > 1:
        raise DataError("several data files", where=where, found=f"encoding {encoding}", allowed="encoding raw")
    if encoding in PACKINGS:
        if skip < 0:
            raise DataError("impossible byte skip", where=where, found=skip, allowed="0 or more, with this encoding")
        packing = PACKINGS[encoding]
        check_packed(sizes[0] - begins[0], skip + needed, packing, where)
        return StreamBytes(files[0], DECODERS[packing], begins[0], keep), skip
    if encoding in TEXTS:
        begin = max(0, begins[0] + skip)
        return numbers_in_text(files[0], begin, sizes[0], stored, needed // stored.itemsize, where), 0
    raise DataError("unsupported encoding", where=where, found=encoding, allowed=("raw", *PACKINGS, *TEXTS))


def _skip_lines(file: Path, begin: int, lines: int) -> int:
    if lines == 0:
        return begin
    with readable(file), file.open("rb") as opened:
        opened.seek(begin)
        for _ in range(lines):
            if not opened.readline():
                raise DataError(f"fewer than {lines} lines to skip", where=str(file))
        return opened.tell()


def _grid_of(header: Mapping[str, Any], kept: Sequence[int], shape_zyx: Index, where: str) -> Grid:
    """Return the grid by the directions and origin of the kept axes; a picture's third axis is its normal."""
    directions = header.get("space directions")
    if directions is None:
        return _grid_of_spacings(header, kept, shape_zyx, where)
    rows = np.asarray(directions, float)[list(kept)]
    origin = np.asarray(header.get("space origin", np.zeros(rows.shape[1])), float)
    if rows.shape[1] == 4:  # the fourth is time
        rows, origin = rows[:, :3], origin[:3]
    steps = np.zeros((3, 3))
    if rows.shape[1] > 3 or len(rows) > 3:
        raise DataError("not a volume in 3-D space", where=where, found=f"space directions {rows.tolist()}")
    steps[: rows.shape[1], : len(rows)] = rows.T
    if len(rows) == 2:
        normal = np.cross(steps[:, 0], steps[:, 1])
        steps[:, 2] = normal / (np.linalg.norm(normal) or 1.0)
    position = np.zeros(3)
    position[: len(origin)] = origin
    factors = np.array([*axis_factors([*header.get("space units", ())][:3], where), 1.0, 1.0, 1.0])[:3]
    return make_grid(shape_zyx, steps * factors[:, None], position * factors, where)


def _grid_of_spacings(header: Mapping[str, Any], kept: Sequence[int], shape_zyx: Index, where: str) -> Grid:
    """Return the grid by spacings, ends and units of the kept axes, x first."""

    def per_axis(*names: str) -> list[Any]:
        values = next((header[name] for name in names if name in header), ())
        values = values.split() if isinstance(values, str) else values
        return [values[axis] if axis < len(values) else None for axis in kept]

    named = (("spacings",), ("axis mins", "axismins"), ("axis maxs", "axismaxs"))
    numbers = [[np.nan if value is None else float(value) for value in per_axis(*names)] for names in named]
    counts, centers = shape_zyx[::-1][: len(kept)], per_axis("centerings", "centers")
    lines = [_even_axis(*each) for each in zip(counts, *numbers, centers, strict=True)] + [(1.0, 0.0)] * (3 - len(kept))
    factors = [*axis_factors([unit or "" for unit in per_axis("units")], where), 1.0][:3]
    spacing, origin = np.array(lines).T * factors
    return make_grid(shape_zyx, np.diag(spacing), origin, where)


def _even_axis(count: int, spacing: float, low: float, high: float, center: str) -> tuple[float, float]:
    """Return the spacing of an axis and its first position; NaN stands for what the header does not have.

    Its ends are those of cells with samples at their centres, or samples. Without a centering, two ends without a
    spacing are those of cells, as for teem, and an end beside a spacing is a sample, as ITK writes it.
    """
    is_cell = center == "cell" or (center != "node" and np.isnan(spacing))
    if np.isnan(spacing):
        spacing = (high - low) / (count if is_cell else max(1, count - 1))
        spacing, is_cell = (1.0, False) if np.isnan(spacing) else (spacing, is_cell)
    inside = spacing / 2 if is_cell else 0.0
    first = high - inside - spacing * (count - 1) if np.isnan(low) else low + inside
    return spacing, 0.0 if np.isnan(first) else first
