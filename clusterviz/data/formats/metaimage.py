"""MetaImage (.mha, and .mhd with the data in other files), the format of ITK, elastix and many medical tools.

Data raw (any box), compressed by zlib (in file order) or as text; in the file itself, in another one, in numbered ones
or in a list of files. A fourth axis is time; of several channels, `channel` is one. The world is ITK's: x to the left,
y to the posterior, z to the superior, if the header has an anatomical orientation.

References
----------
ITK, "MetaIO documentation", https://docs.itk.org/en/latest/learn/metaio.html
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, select
from clusterviz.data.files import kind_of, readable, refuse_array, require_file
from clusterviz.data.header import check_packed, check_size, make_grid, stated_numbers
from clusterviz.data.source import Grid, Index
from clusterviz.data.storage import (
    MAX_FILES,
    FileBytes,
    Inflated,
    Storage,
    StreamBytes,
    StridedSource,
    file_ranges,
    numbered_names,
    numbers_in_text,
    slab_source,
)
from clusterviz.errors import DataError

TYPES = {"MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2", "MET_INT": "i4"}
TYPES |= {"MET_UINT": "u4", "MET_LONG": "i4", "MET_ULONG": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8"}
TYPES |= {"MET_FLOAT": "f4", "MET_DOUBLE": "f8"}
LETTERS = {2: "YX", 3: "ZYX", 4: "TZYX"}
MAX_LINE, MAX_LINES = 1 << 16, 1 << 10
ZLIB_OR_GZIP = 47


def open_metaimage(path: Path, subset: Subset) -> StridedSource:
    refuse_array(subset.array, path)
    where = str(path)
    fields, files, begin = _read_header(path)
    count = _integers(fields, "NDims", 1, where)[0]
    if count not in LETTERS or fields.get("ObjectType", "Image") != "Image":
        found = f"ObjectType {fields.get('ObjectType', 'Image')}, NDims {count}"
        raise DataError("not an image of 2 to 4 axes", where=where, found=found)
    sizes = _integers(fields, "DimSize", count, where)
    channels = _integers(fields, "ElementNumberOfChannels", 1, where, [1])
    slab = select([*reversed(sizes), *channels], LETTERS[count] + "C", subset, where)
    stored = _stored_dtype(fields, where)
    needed, keep = slab.samples * stored.itemsize, max(slab.strides(stored.itemsize)[1])
    storage = _storage(fields, files, begin, needed, keep, stored, where)
    return slab_source(where, slab, _grid_of(fields, count, slab.shape_zyx, where), storage, stored)


def _read_header(path: Path) -> tuple[dict[str, str], list[Path], int]:
    fields: dict[str, str] = {}
    listed: list[str] = []
    with readable(path), path.open("rb") as file:
        for _ in range(MAX_LINES):
            key, equals, value = file.readline(MAX_LINE).decode("utf-8", "replace").partition("=")
            if not equals:
                break
            fields[key.strip()] = value.strip()
            if key.strip() == "ElementDataFile":
                break
        begin = file.tell()
        if value.split()[:1] == ["LIST"]:
            names = file.read(MAX_LINE * MAX_LINES).decode("utf-8", "replace").splitlines()
            listed = [name.strip() for name in names if name.strip()]
        file.seek(0)
        start = file.read(64)
    entry = fields.get("ElementDataFile", "")
    if not entry or "NDims" not in fields or len(listed) > MAX_FILES:
        allowed = "a MetaImage header, whose last line is ElementDataFile"
        raise DataError("truncated, or wrong magic", where=str(path), found=kind_of(start), allowed=allowed)
    if entry.upper() == "LOCAL":
        return fields, [path], begin
    names = listed or numbered_names(entry, str(path))
    return fields, [path.parent / name for name in names], 0


def _numbers(fields: Mapping[str, str], key: str, count: int, where: str, default: Any = None) -> NDArray[np.float64]:
    return stated_numbers(fields.get(key, default), key, count, where)


def _integers(fields: Mapping[str, str], key: str, count: int, where: str, default: Any = None) -> list[int]:
    numbers = _numbers(fields, key, count, where, default)
    if (numbers % 1).any():
        raise DataError(f"impossible {key}", where=where, found=fields[key], allowed=f"{count} whole numbers")
    return [int(number) for number in numbers]


def _is_true(fields: Mapping[str, str], key: str, default: bool = False) -> bool:
    return fields[key][:1].upper() in ("T", "1") if fields.get(key) else default


def _stored_dtype(fields: Mapping[str, str], where: str) -> np.dtype[Any]:
    kind = fields.get("ElementType", "").removesuffix("_ARRAY")
    if kind not in TYPES:
        raise DataError("not a scalar volume", where=where, found=f"ElementType {kind}", allowed=", ".join(TYPES))
    big = _is_true(fields, "BinaryDataByteOrderMSB") or _is_true(fields, "ElementByteOrderMSB")
    return np.dtype(TYPES[kind]).newbyteorder(">" if big else "<")


def _storage(
    fields: Mapping[str, str], files: list[Path], begin: int, needed: int, keep: int, stored: np.dtype[Any], where: str
) -> Storage:
    skip = _integers(fields, "HeaderSize", 1, where, [0])[0]
    packed, binary = _is_true(fields, "CompressedData"), _is_true(fields, "BinaryData", True)
    if skip < -1 or (skip == -1 and (packed or not binary)):
        raise DataError("impossible HeaderSize", where=where, found=skip, allowed="0 or more; or -1 for raw data")
    sizes = [require_file(file) for file in files]
    if binary and not packed:
        return FileBytes(file_ranges(files, sizes, [begin] * len(files), skip, needed))
    if len(files) > 1:
        raise DataError("several data files", where=where, allowed="raw data in each, neither compressed nor text")
    begin, there = begin + skip, sizes[0] - begin - skip
    if packed:
        told = _integers(fields, "CompressedDataSize", 1, where, [there])[0]
        check_size(there, told, str(files[0]))
        check_packed(told, needed, "gzip", where)
        return StreamBytes(files[0], lambda file: Inflated(file, ZLIB_OR_GZIP), begin, keep)
    return numbers_in_text(files[0], begin, sizes[0], stored, needed // stored.itemsize, where)


def _grid_of(fields: Mapping[str, str], count: int, shape_zyx: Index, where: str) -> Grid:
    """Return the grid; each row of the matrix is the direction of one axis."""

    def first(*keys: str) -> str:
        return next((key for key in keys if key in fields), keys[0])

    kept = min(count, 3)
    spacing, origin, axes = np.ones(3), np.zeros(3), np.eye(3)
    spacing[:kept] = _numbers(fields, first("ElementSpacing", "ElementSize"), count, where, [1] * count)[:kept]
    origin[:kept] = _numbers(fields, first("Offset", "Position", "Origin"), count, where, [0] * count)[:kept]
    matrix = first("TransformMatrix", "Rotation", "Orientation")
    rows = _numbers(fields, matrix, count * count, where, np.eye(count))
    axes[:kept, :kept] = np.reshape(rows, (count, count))[:kept, :kept].T
    grid = make_grid(shape_zyx, axes * spacing, origin, where)
    known = "?" not in fields.get("AnatomicalOrientation", "?")
    modality = fields.get("Modality", "").upper().removeprefix("MET_MOD_")
    return replace(
        grid, orientation="LPS" if known else "", modality=modality if modality in ("CT", "MR", "NM", "US") else ""
    )
