"""VTK image files in XML (.vti), as ParaView, PyVista and many simulations write them.

Data inline (ascii, base64) or appended (base64, raw), uncompressed or in blocks compressed by zlib, LZ4 or LZMA. Boxes
are read separately, except from ascii. Point data lies on the samples; cell data is point data at the cells' centres.
Without a name the active scalars are taken, or the only scalar array. (The vtk package could read them too, at 566 MB.)
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, select
from clusterviz.data.files import readable, require_file
from clusterviz.data.grid import Grid
from clusterviz.data.header import check_dtype, check_packed, check_size
from clusterviz.data.storage import FileBytes, FileRange, LoadedBytes, Storage, numbers_from_text
from clusterviz.data.strided import StridedSource
from clusterviz.data.vti_blocks import unpack
from clusterviz.data.vti_layout import VtiArray, VtiLayout, scan_vti
from clusterviz.data.vtk_image import choose_array, image_grid
from clusterviz.errors import DataError

TYPES = {
    f"{kind}{8 * size}": f"{letter}{size}" for kind, letter in (("Int", "i"), ("UInt", "u")) for size in (1, 2, 4, 8)
}
TYPES |= {"Float32": "f4", "Float64": "f8"}
ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
BLANKS = b" \t\r\n"


def open_vti(path: Path, subset: Subset) -> StridedSource:
    """Open one scalar array of a VTK image file.

    Raises
    ------
    DataError
        Not such a file, damaged or truncated, several pieces, no such array, several and none named, or vectors.
    """
    size = require_file(path)
    layout = scan_vti(path)
    scalars = [a for a in layout.arrays if int(a.attributes.get("NumberOfComponents") or 1) == 1]
    chosen = choose_array(scalars, subset.array, "scalar array", path)
    where = f"{path}:{chosen.name}" if len(layout.arrays) > 1 else str(path)
    stored = _stored_dtype(layout, chosen, where)
    grid = _grid_of(layout, chosen.on_cells, path)
    select(grid.shape_zyx, "ZYX", subset, where)
    count = int(np.prod(grid.shape_zyx, dtype=object))
    storage, offset = _storage(path, size, layout, chosen, stored, count, where)
    return StridedSource(where, grid, check_dtype(stored, where), storage, stored, offset)


def _stored_dtype(layout: VtiLayout, chosen: VtiArray, where: str) -> np.dtype[Any]:
    kind = chosen.attributes.get("type", "")
    if kind not in TYPES:
        raise DataError("not a scalar volume", where=where, found=f"type {kind}", allowed=", ".join(TYPES))
    return np.dtype(_byte_order(layout, where) + TYPES[kind])


def _byte_order(layout: VtiLayout, where: str) -> str:
    order = layout.file.get("byte_order", "LittleEndian")
    if order not in ORDERS:
        raise DataError("impossible byte_order", where=where, found=order, allowed=", ".join(ORDERS))
    return ORDERS[order]


def _grid_of(layout: VtiLayout, on_cells: bool, path: Path) -> Grid:
    """Return the grid of the samples; the origin belongs to index 0, and the extent may begin elsewhere."""
    where, image = str(path), layout.image
    if len(layout.pieces) != 1:
        raise DataError("unsupported", where=where, found=f"{len(layout.pieces)} pieces", allowed="one piece")
    extent = _numbers(layout.pieces[0], "Extent", image.get("WholeExtent", ""), 6, where).reshape(3, 2)
    if "WholeExtent" in image and (extent != _numbers(image, "WholeExtent", "", 6, where).reshape(3, 2)).any():
        raise DataError(
            "unsupported: the piece is not the whole", where=where, found=extent.tolist(), allowed=image["WholeExtent"]
        )
    points = extent[:, 1] - extent[:, 0] + 1
    spacing = _numbers(image, "Spacing", "1 1 1", 3, where)
    steps = _numbers(image, "Direction", "1 0 0 0 1 0 0 0 1", 9, where).reshape(3, 3) * spacing
    origin = _numbers(image, "Origin", "0 0 0", 3, where)
    return image_grid(points, steps, origin, extent[:, 0], on_cells, where)


def _numbers(attributes: Mapping[str, str], key: str, default: str, count: int, where: str) -> NDArray[np.float64]:
    text = attributes.get(key, default)
    try:
        numbers = np.array(text.split(), float)
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise DataError(f"impossible {key}", where=where, found=repr(text), allowed=f"{count} numbers")
    return numbers


def _storage(
    path: Path, size: int, layout: VtiLayout, chosen: VtiArray, stored: np.dtype[Any], count: int, where: str
) -> tuple[Storage, int]:
    """Return the storage of the array's bytes, and the offset of the first sample in it."""
    form = chosen.attributes.get("format", "ascii")
    file = FileBytes([FileRange(path, 0, size)])
    total = count * stored.itemsize
    if form == "ascii":
        begin, end = chosen.text_begin, chosen.text_end
        check_packed(end - begin, count, "text", where)
        return LoadedBytes(lambda: numbers_from_text(file.read_at(begin, end - begin), stored, count, where), where), 0
    kind = layout.file.get("header_type", "UInt32")
    if kind not in ("UInt32", "UInt64"):
        raise DataError("impossible header_type", where=where, found=kind, allowed="UInt32, UInt64")
    integer = np.dtype(_byte_order(layout, where) + TYPES[kind])
    begin, text = _begin_of(path, layout, chosen, form, where)
    compressor = layout.file.get("compressor", "")
    storage, offset = unpack(file, begin, text, integer, compressor, total, where)
    if storage is file:
        check_size(size, offset + total, where)
    storage.read_at(offset + total - 1, 1)  # detects a truncated file before the first frame
    return storage, offset


def _begin_of(path: Path, layout: VtiLayout, chosen: VtiArray, form: str, where: str) -> tuple[int, bool]:
    """Return the offset of the array in the file, and whether it is base64 text."""
    if form == "binary":
        return _first_character(path, chosen.text_begin), True
    if form != "appended":
        raise DataError("unknown format", where=where, found=form, allowed="ascii, binary, appended")
    if layout.appended_encoding not in ("raw", "base64"):
        found = layout.appended_encoding or "no AppendedData"
        raise DataError("no such appended data", where=where, found=found, allowed="encoding raw or base64")
    offset = chosen.attributes.get("offset", "")
    if not offset.strip().isdigit():
        raise DataError("impossible offset", where=where, found=repr(offset), allowed="a whole number")
    return layout.appended_begin + int(offset), layout.appended_encoding == "base64"


def _first_character(path: Path, begin: int) -> int:
    """Skip the blanks before inline text."""
    with readable(path), path.open("rb") as file:
        file.seek(begin)
        head = file.read(4096)
    return begin + len(head) - len(head.lstrip(BLANKS))
