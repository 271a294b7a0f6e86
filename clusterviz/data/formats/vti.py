"""VTK image files in XML (.vti), as ParaView, PyVista and many simulations write them.

Data inline (ascii, base64) or appended (base64, raw), uncompressed or in blocks compressed by zlib, LZ4 or LZMA. Boxes
are read separately, except from ascii. Point data lies on the samples; cell data is point data at the cells' centres.
Without a name the active scalars are taken, or the only scalar array. (The vtk package could read them too, at 566 MB.)

The parser notes byte positions instead of inline data, and stops at appended data (raw bytes are not XML), so a file of
any size takes little memory.

References
----------
VTK File Formats, "XML File Formats", https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import base64
import binascii
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from itertools import accumulate
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, select
from clusterviz.data.files import kind_of, readable, require_file, start_of
from clusterviz.data.header import check_dtype, check_packed, check_size
from clusterviz.data.source import Grid
from clusterviz.data.storage import FileBytes, FileRange, LoadedBytes, Storage, numbers_from_text
from clusterviz.data.strided import StridedSource
from clusterviz.data.vtk_image import choose_array, image_grid
from clusterviz.errors import DataError

CHUNK = 1 << 16
Attributes = Mapping[str, str]


@dataclass(frozen=True)
class VtiArray:
    """DataArray of a .vti file; its inline text is at bytes `text_begin` to `text_end` of the file."""

    name: str
    on_cells: bool
    active: bool
    attributes: Attributes
    text_begin: int
    text_end: int


@dataclass
class VtiLayout:
    """Attributes of the file, image, pieces and appended data, and the arrays in order."""

    file: Attributes = field(default_factory=dict)
    image: Attributes = field(default_factory=dict)
    pieces: list[Attributes] = field(default_factory=list)
    arrays: list[VtiArray] = field(default_factory=list)
    appended_encoding: str | None = None
    appended_begin: int = 0


class _AppendedReached(Exception):  # noqa: N818 - ends the parsing; nothing is wrong
    pass


class _Scan:
    """One pass over the XML; `stack` holds the names of the open tags."""

    def __init__(self) -> None:
        self.layout = VtiLayout()
        self.stack: list[str] = []
        self.attributes: Attributes = {}
        self.text_begin: int | None = None
        self.active = {False: "", True: ""}
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        layout, parent = self.layout, self.stack[-1] if self.stack else ""
        self.stack.append(tag)
        if tag == "VTKFile":
            layout.file = attributes
        elif tag == "ImageData":
            layout.image = attributes
        elif tag == "Piece":
            layout.pieces.append(attributes)
        elif tag in ("PointData", "CellData"):
            self.active[tag == "CellData"] = attributes.get("Scalars", "")
        elif tag == "DataArray" and parent in ("PointData", "CellData"):
            self.attributes = attributes
            self._await_text()
        elif tag == "AppendedData":
            layout.appended_encoding = attributes.get("encoding", "base64")
            layout.appended_begin = self.parser.CurrentByteIndex
            raise _AppendedReached

    def _end(self, tag: str) -> None:
        self.stack.pop()
        parent, end = self.stack[-1] if self.stack else "", self.parser.CurrentByteIndex
        if parent == "DataArray":
            self._await_text()  # the data follows the information keys
        elif tag == "DataArray" and parent in ("PointData", "CellData"):
            begin = end if self.text_begin is None else self.text_begin
            name, on_cells = self.attributes.get("Name", ""), parent == "CellData"
            active = bool(name) and self.active[on_cells] == name
            self.layout.arrays.append(VtiArray(name, on_cells, active, self.attributes, begin, end))

    def _await_text(self) -> None:
        self.text_begin = None
        self.parser.CharacterDataHandler = self._text

    def _text(self, _: str) -> None:
        if self.text_begin is None:
            self.text_begin = self.parser.CurrentByteIndex
        self.parser.CharacterDataHandler = None


def scan_vti(path: Path) -> VtiLayout:
    """Read the XML of the file at `path` up to its appended data.

    Raises
    ------
    DataError
        Not XML, ends early, or not a VTK file of type ImageData.
    """
    scan, layout = _Scan(), VtiLayout()
    with readable(path), path.open("rb") as file:
        try:
            while chunk := file.read(CHUNK):
                scan.parser.Parse(chunk, False)
            scan.parser.Parse(b"", True)
        except _AppendedReached:
            scan.layout.appended_begin = _after_underscore(file, scan.layout.appended_begin, path)
        except expat.ExpatError as error:
            found = kind_of(start_of(path))
            raise DataError(
                f"truncated or damaged XML: {error}", where=str(path), found=found, allowed="VTK's XML"
            ) from error
        finally:
            layout = scan.layout
            scan.parser.StartElementHandler = scan.parser.EndElementHandler = None  # no reference cycle stays
    kind: Any = layout.file.get("type")
    if kind != "ImageData":
        raise DataError("not a VTK image file", where=str(path), found=f"type {kind}", allowed="VTKFile type ImageData")
    return layout


def _after_underscore(file: Any, tag_begin: int, path: Path) -> int:
    """Return the position of the first appended byte, after the underscore that follows the AppendedData tag."""
    file.seek(tag_begin)
    head = file.read(4096)
    found = head.find(b"_", head.find(b">") + 1)
    if found < 0:
        raise DataError("truncated: the appended data is missing", where=str(path))
    return int(tag_begin + found + 1)


PACKINGS = {"vtkZLibDataCompressor": "gzip", "vtkLZ4DataCompressor": "lz4", "vtkLZMADataCompressor": "lzma"}


@dataclass(frozen=True)
class Base64Bytes:
    """Decoded bytes of base64 text without blanks; four characters hold three bytes.

    Attributes
    ----------
    text : the file
    begin : offset of the text in it
    where : the file, for messages
    """

    text: Storage
    begin: int
    where: str

    def read_at(self, offset: int, count: int) -> bytes:
        first, last = offset // 3, -(-(offset + count) // 3)
        characters = self.text.read_at(self.begin + 4 * first, 4 * (last - first))
        try:
            decoded = base64.b64decode(characters, validate=True)
        except binascii.Error as error:
            raise DataError(f"damaged base64 text: {error}", where=self.where) from error
        part = decoded[offset - 3 * first : offset - 3 * first + count]
        if len(part) != count:
            raise DataError(f"the base64 text ends {count - len(part)} bytes early", where=self.where)
        return part


class BlockBytes:
    """Blocks of `block_bytes` each (the last may be shorter), compressed separately; the last one read is kept.

    Parameters
    ----------
    packed : storage of the compressed blocks
    begins : the blocks' offsets in `packed`, and the end of the last
    block_bytes, total_bytes : uncompressed
    decompress : (packed bytes, bytes expected) -> bytes
    where : the file, for messages
    """

    def __init__(
        self,
        packed: Storage,
        begins: list[int],
        block_bytes: int,
        total_bytes: int,
        decompress: Callable[[bytes, int], bytes],
        where: str,
    ) -> None:
        self._packed, self._begins, self._decompress, self._where = packed, begins, decompress, where
        self._block_bytes, self._total_bytes = block_bytes, total_bytes
        self._held: tuple[int, bytes] = (-1, b"")

    def read_at(self, offset: int, count: int) -> bytes:
        if offset + count > self._total_bytes:
            raise DataError("the data ends early", where=self._where, found=f"{self._total_bytes} bytes")
        size, parts = self._block_bytes, []
        for number in range(offset // size, -(-(offset + count) // size)):
            block = self._block(number)
            parts.append(block[max(0, offset - number * size) : offset + count - number * size])
        return b"".join(parts)

    def _block(self, number: int) -> bytes:
        if self._held[0] == number:
            return self._held[1]
        begin, end = self._begins[number : number + 2]
        expected = min(self._block_bytes, self._total_bytes - number * self._block_bytes)
        packed = bytes(self._packed.read_at(begin, end - begin))
        try:
            block = self._decompress(packed, expected)
        except Exception as error:  # libraries raise many kinds
            raise DataError(f"block {number} is damaged: {error}", where=self._where) from error
        if len(block) != expected:
            raise DataError(
                f"block {number} is damaged", where=self._where, found=f"{len(block)} bytes", allowed=expected
            )
        self._held = number, block
        return block


def decompressor(name: str, where: str) -> Callable[[bytes, int], bytes]:
    """Return the function that decompresses blocks of VTK's compressor `name`.

    Raises
    ------
    DataError
        Unknown, or its library is not installed.
    """
    # One byte more than expected detects a block that is too long.
    if name == "vtkZLibDataCompressor":
        return lambda packed, expected: zlib.decompressobj().decompress(packed, expected + 1)
    if name == "vtkLZMADataCompressor":
        import lzma

        return lambda packed, expected: lzma.LZMADecompressor().decompress(packed, expected + 1)
    if name == "vtkLZ4DataCompressor":
        try:
            lz4_block = import_module("lz4.block")
        except ImportError as error:
            raise DataError("LZ4 compression needs the lz4 package", where=where) from error
        return lambda packed, expected: bytes(lz4_block.decompress(packed, uncompressed_size=expected))
    raise DataError("unsupported compressor", where=where, found=name, allowed=", ".join(PACKINGS))


def unpack(
    file: Storage, begin: int, text: bool, integer: np.dtype[Any], compressor: str, total: int, where: str
) -> tuple[Storage, int]:
    """Return the storage of an array's `total` uncompressed bytes, and the offset of the first of them.

    Parameters
    ----------
    file, begin : storage of the file, and offset of the array, which begins with a header
    text : base64, not raw bytes
    integer : dtype of the header's numbers
    compressor : VTK's name of it; empty for none

    Raises
    ------
    DataError
        The array's header disagrees with the image's size, or is damaged.
    """

    def header(count: int) -> list[int]:
        numbers = encoded.read_at(start, count * integer.itemsize)
        return [int(n) for n in np.frombuffer(numbers, integer)]

    start = 0 if text else begin
    encoded: Storage = Base64Bytes(file, begin, where) if text else file
    if not compressor:
        _check_total(header(1)[0], total, where)
        return _after_header(file, encoded, begin, text, integer.itemsize)
    blocks, block_bytes, last_bytes = header(3)
    if not block_bytes:
        raise DataError("blocks without bytes", where=where)
    full_blocks = blocks - 1 if last_bytes else blocks
    _check_total(full_blocks * block_bytes + last_bytes, total, where)
    packed_sizes = header(3 + blocks)[3:]
    decompress = decompressor(compressor, where)
    check_packed(sum(packed_sizes), total, PACKINGS[compressor], where)
    header_bytes = (3 + blocks) * integer.itemsize
    packed: Storage = file
    first = begin + header_bytes
    if text:  # the blocks are a separate base64 text
        packed, first = Base64Bytes(file, begin + 4 * -(-header_bytes // 3), where), 0
    begins = list(accumulate(packed_sizes, initial=first))
    return BlockBytes(packed, begins, block_bytes, total, decompress, where), 0


def _after_header(file: Storage, encoded: Storage, begin: int, text: bool, header_bytes: int) -> tuple[Storage, int]:
    """Return the storage after the header: the same base64 text, or a new one as some writers make it."""
    characters = 4 * -(-header_bytes // 3)
    if isinstance(encoded, Base64Bytes) and bytes(file.read_at(begin, characters)).endswith(b"="):
        return Base64Bytes(file, begin + characters, encoded.where), 0
    return encoded, header_bytes if text else begin + header_bytes


def _check_total(found: int, total: int, where: str) -> None:
    if found != total:
        raise DataError("the array's size is not the image's", where=where, found=f"{found} bytes", allowed=f"{total}")


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
