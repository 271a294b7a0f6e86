"""MRC and CCP4 maps (.mrc, .map, .ccp4, also .gz), of cryo-electron microscopy and crystallography.

Modes 0 (int8; uint8 if IMOD's stamp says so), 1 (int16), 2 (float32), 6 (uint16) and 12 (float16). The byte order comes
from the machine stamp, the spacing and the axes' angles from the unit cell (Å), the origin from the start indices or,
if those are zero, from the ORIGIN field of MRC-2014. Columns, rows and sections may be any of x, y and z. Old files
leave axes and intervals blank: then columns lie along x, and the unit cell holds the samples.

References
----------
Cheng et al., MRC2014: extensions to the MRC format header, J. Struct. Biol. 192 (2015), table 1.
"""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, select
from clusterviz.data.files import kind_of, refuse_array, require_file, start_of
from clusterviz.data.header import check_packed, check_shape, check_size, make_grid
from clusterviz.data.storage import FileBytes, FileRange, Storage, StreamBytes, StridedSource
from clusterviz.errors import DataError

HEADER_BYTES = 1024
MODES = {0: "i1", 1: "i2", 2: "f4", 6: "u2", 12: "f2"}
IMOD_STAMP = 1146047817


def open_mrc(path: Path, subset: Subset) -> StridedSource:
    where, packed = str(path), path.name.lower().endswith(".gz")
    size = require_file(path)
    refuse_array(subset.array, path)
    if not packed and size < HEADER_BYTES:
        found = f"{size} bytes, {kind_of(start_of(path))}"
        allowed = f"{HEADER_BYTES} and more"
        raise DataError("too short to be an MRC or CCP4 map", where=where, found=found, allowed=allowed)
    stream = StreamBytes(path, gzip.open)
    storage: Storage = stream if packed else FileBytes([FileRange(path, 0, size)])
    header = bytes(storage.read_at(0, HEADER_BYTES))
    order = _byte_order(header, where)
    words = np.frombuffer(header, order + "i4")
    stored = _stored_dtype(words, header, order, where)
    sizes = check_shape(words[2::-1].tolist(), where)  # sections, rows, columns
    xyz_of_column_row_section = words[16:19].tolist() if words[16:19].any() else [1, 2, 3]
    if sorted(xyz_of_column_row_section) != [1, 2, 3]:
        found = str(xyz_of_column_row_section)
        raise DataError("impossible axis order", where=where, found=found, allowed="1, 2, 3 in any order")
    section, row, column = (3 - axis for axis in reversed(xyz_of_column_row_section))
    file_axes = section, row, column
    shape_zyx = tuple(sizes[file_axes.index(a)] for a in range(3))
    select(shape_zyx, "ZYX", subset, where)
    start_xyz = np.array([words[4 + xyz_of_column_row_section.index(a)] for a in (1, 2, 3)], float)
    steps = _cell_steps(words, shape_zyx[::-1], where)
    origin = steps @ start_xyz if start_xyz.any() else words[49:52].view(order + "f4").astype(float)
    grid = replace(make_grid(check_shape(shape_zyx, where), steps, origin, where), modality="density")
    offset = HEADER_BYTES + max(0, int(words[23]))  # the extended header: symmetry records
    row_bytes = sizes[2] * stored.itemsize
    plane_bytes = sizes[1] * row_bytes
    stream.keep = plane_bytes
    if packed:
        check_packed(size, offset + sizes[0] * plane_bytes, "gzip", where)
    else:
        check_size(size, offset + sizes[0] * plane_bytes, where)
    z, y, x = ((plane_bytes, row_bytes, stored.itemsize)[file_axes.index(a)] for a in range(3))
    return StridedSource(where, grid, stored.newbyteorder("="), storage, stored, offset, (z, y, x))


def _byte_order(header: bytes, where: str) -> str:
    """Return '<' or '>' by the machine stamp, or by the mode if the stamp is blank."""
    if header[208:211] != b"MAP":
        found = f"{kind_of(header)}; at byte 208 {header[208:212]!r}"
        allowed = "an MRC or CCP4 map, with 'MAP ' at byte 208"
        raise DataError("wrong magic: not what its name says", where=where, found=found, allowed=allowed)
    if header[212] == 0x44:
        return "<"
    if header[212] == 0x11:
        return ">"
    return "<" if np.frombuffer(header, "<i4", 1, 12)[0] in MODES else ">"


def _stored_dtype(words: NDArray[Any], header: bytes, order: str, where: str) -> np.dtype[Any]:
    mode = int(words[3])
    if mode not in MODES:
        raise DataError("unsupported mode", where=where, found=mode, allowed=", ".join(map(str, MODES)))
    if mode == 0 and words[38] == IMOD_STAMP and not words[39] & 1:
        return np.dtype(np.uint8)
    return np.dtype(order + MODES[mode])


def _cell_steps(words: NDArray[Any], counts_xyz: Sequence[int], where: str) -> NDArray[np.float64]:
    """Return the steps along the cell axes in Å, float64 (3, 3), a column each; a lies along x, b in the xy plane."""
    cell = words[10:16].view(words.dtype.str.replace("i", "f")).astype(float)
    intervals = (words[7:10] if words[7:10].any() else np.array(counts_xyz)).astype(float)
    if not (intervals > 0).all():
        raise DataError("impossible grid intervals", where=where, found=intervals, allowed="1 or more")
    if not cell[:3].any():
        cell[:3] = intervals  # a blank cell: samples 1 apart
    angles = np.where(cell[3:] == 0, 90.0, cell[3:])
    cos_alpha, cos_beta, cos_gamma = np.where(angles == 90.0, 0.0, np.cos(np.radians(angles)))
    sin_gamma = np.sqrt(1 - cos_gamma**2)
    b_part = (cos_alpha - cos_beta * cos_gamma) / sin_gamma if sin_gamma else np.nan
    axes = np.array(
        [[1, cos_gamma, cos_beta], [0, sin_gamma, b_part], [0, 0, np.sqrt(max(0.0, 1 - cos_beta**2 - b_part**2))]]
    )
    steps: NDArray[np.float64] = axes * (cell[:3] / intervals)
    return steps
