"""NumPy files (.npy), and archives of them (.npz), in C or Fortran order and any byte order.

Four axes are (time, z, y, x), or (channel, z, y, x) if a channel is named; five are (time, channel, z, y, x). The files
have no spacing: samples lie 1 apart, the first at the origin, unless the scene sets the grid. An archive with a single
array, or a single one of three axes or more, needs no name; stored arrays are read box by box, compressed ones in file
order.
"""

from __future__ import annotations

import struct
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.data.axes import Subset, UnnamedPartError, select, unnamed_axes
from clusterviz.data.files import explained, readable, refuse_array, require_file
from clusterviz.data.header import check_dtype, check_packed, check_size
from clusterviz.data.source import Grid
from clusterviz.data.storage import FileBytes, FileRange, Inflated, Storage, StreamBytes, StridedSource, slab_source
from clusterviz.errors import DataError


def open_npy(path: Path, subset: Subset) -> StridedSource:
    size = require_file(path)
    refuse_array(subset.array, path)
    where = str(path)
    with readable(path), path.open("rb") as file:
        shape, fortran, stored = read_header(file, where)
        begin = file.tell()
    check_dtype(stored, where)
    slab = select(shape, unnamed_axes(shape, subset), subset, where)
    needed = slab.samples * stored.itemsize
    check_size(size - begin, needed, where, exact=True)
    storage = FileBytes([FileRange(path, begin, needed)])
    return slab_source(where, slab, Grid(slab.shape_zyx), storage, stored, fortran=fortran)


def read_header(file: Any, where: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    with explained("the header cannot be read", where, ValueError):
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, stored = read(file)
        return shape, fortran, stored


MAX_ARRAYS = 1 << 12
LOCAL_HEADER = 30  # bytes, after which name and extra field follow
RAW_DEFLATE = -15


@dataclass(frozen=True)
class _Member:
    """Array of an archive; the first `header_bytes` of its .npy file lie before the samples."""

    entry: zipfile.ZipInfo
    shape: tuple[int, ...]
    fortran: bool
    stored: np.dtype[Any]
    header_bytes: int


def open_npz(path: Path, subset: Subset) -> StridedSource:
    size = require_file(path)
    kinds = (zipfile.BadZipFile, NotImplementedError, RuntimeError, struct.error)
    with explained("truncated or damaged", path, *kinds), readable(path), zipfile.ZipFile(path) as archive:
        name, member = _choose(_members(archive, path), subset, path)
        begin = _data_begin(archive, member.entry)
    entry, stored, where = member.entry, member.stored, f"{path}:{name}"
    check_dtype(stored, where)
    slab = select(member.shape, unnamed_axes(member.shape, subset), subset, where)
    check_size(entry.file_size, member.header_bytes + slab.samples * stored.itemsize, where, exact=True)
    check_size(size, begin + entry.compress_size, where)
    storage: Storage
    if entry.compress_type == zipfile.ZIP_STORED:
        check_size(entry.compress_size, entry.file_size, where)
        storage = FileBytes([FileRange(path, begin, entry.file_size)])
    elif entry.compress_type == zipfile.ZIP_DEFLATED:
        check_packed(entry.compress_size, entry.file_size, "gzip", where)
        checksum = entry.file_size, entry.CRC
        keep = max(slab.strides(stored.itemsize, member.fortran)[1])
        storage = StreamBytes(path, lambda file: Inflated(file, RAW_DEFLATE, checksum), begin, keep)
    else:
        raise DataError("unsupported compression", where=where, found=entry.compress_type, allowed="none or deflate")
    return slab_source(where, slab, Grid(slab.shape_zyx), storage, stored, member.header_bytes, member.fortran)


def _members(archive: zipfile.ZipFile, path: Path) -> dict[str, _Member]:
    entries = [entry for entry in archive.infolist() if entry.filename.endswith(".npy")]
    if len(entries) > MAX_ARRAYS:
        raise DataError("too many arrays", where=str(path), found=len(entries), allowed=f"at most {MAX_ARRAYS}")
    members = {}
    for entry in entries:
        with archive.open(entry) as stream:
            name = entry.filename.removesuffix(".npy")
            shape, fortran, stored = read_header(stream, f"{path}:{name}")
            members[name] = _Member(entry, shape, fortran, stored, stream.tell())
    return members


def _choose(members: dict[str, _Member], subset: Subset, path: Path) -> tuple[str, _Member]:
    array = subset.array
    listed = ", ".join(f"{name} {member.shape}" for name, member in members.items()) or "none: the archive holds none"
    if array is not None:
        if array not in members:
            raise DataError("no such array", where=str(path), found=array, allowed=listed)
        return array, members[array]
    volumes = {name: member for name, member in members.items() if len(member.shape) >= (4 if subset.vectors else 3)}
    only = members if len(members) == 1 else volumes
    if not only:
        raise DataError("no volume", where=str(path), allowed=listed)
    if len(only) > 1:
        raise UnnamedPartError("array", list(only), where=str(path), allowed=listed)
    return next(iter(only.items()))


def _data_begin(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> int:
    file: Any = archive.fp
    file.seek(entry.header_offset)
    name_bytes, extra_bytes = struct.unpack("<26x2H", file.read(LOCAL_HEADER))
    return int(entry.header_offset + LOCAL_HEADER + name_bytes + extra_bytes)
