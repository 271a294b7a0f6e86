"""VTK's XML files: their arrays, and how one is read.

Data inline (ascii, base64) or appended (base64, raw), uncompressed or in blocks compressed by zlib, LZ4 or LZMA. Boxes
of images are read separately, except from ascii. (The vtk package could read them too, at 566 MB.)

The parser notes byte positions instead of inline data, and stops at appended data (raw bytes are not XML), so a file of
any size takes little memory.

References
----------
VTK File Formats, "XML File Formats", https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import base64
import binascii
import lzma
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any
from xml.parsers import expat

import lz4.block  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import explained, kind_of, readable, require_file, start_of
from clusterviz.data.header import check_packed, check_size
from clusterviz.data.storage import FileBytes, FileRange, Storage, numbers_in_text
from clusterviz.data.vtk_image import ImageArray
from clusterviz.errors import DataError

CHUNK = 1 << 16
Attributes = Mapping[str, str]


SECTIONS = ("PointData", "CellData", "Points", "Verts", "Lines", "Strips", "Polys", "Cells", "Coordinates")
"""Tags whose arrays are noted."""


@dataclass(frozen=True)
class XmlArray(ImageArray):
    """DataArray of a file.

    Attributes
    ----------
    components : numbers for each tuple; 0 if the file does not say it properly
    section : the tag that it lies in, one of `SECTIONS`
    piece : number of its piece
    text_begin, text_end : bytes of the file that hold its inline text
    """

    section: str = ""
    piece: int = 0
    attributes: Attributes = field(default_factory=dict)
    text_begin: int = 0
    text_end: int = 0


@dataclass
class XmlLayout:
    """Attributes of the file, dataset, pieces and appended data, and the arrays in order."""

    file: Attributes = field(default_factory=dict)
    dataset: Attributes = field(default_factory=dict)
    pieces: list[Attributes] = field(default_factory=list)
    arrays: list[XmlArray] = field(default_factory=list)
    appended_encoding: str | None = None
    appended_begin: int = 0


class _AppendedReached(Exception):  # noqa: N818 - ends the parsing; nothing is wrong
    pass


class _Scan:
    """One pass over the XML; `stack` holds the names of the open tags."""

    def __init__(self) -> None:
        self.layout = XmlLayout()
        self.stack: list[str] = []
        self.attributes: Attributes = {}
        self.text_begin: int | None = None
        self.text_end: int | None = None
        self.active = ""
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        layout, parent = self.layout, self.stack[-1] if self.stack else ""
        self.stack.append(tag)
        if parent == "DataArray" and self.text_begin is not None and self.text_end is None:
            self.text_end = self.parser.CurrentByteIndex  # information keys precede or follow the data
        if tag == "VTKFile":
            layout.file = attributes
        elif parent == "VTKFile" and tag == layout.file.get("type"):
            layout.dataset = attributes
        elif tag == "Piece":
            layout.pieces.append(attributes)
        elif tag in ("PointData", "CellData"):
            self.active = attributes.get("Scalars", "")
        elif tag == "DataArray" and parent in SECTIONS:
            self.attributes, self.text_begin, self.text_end = attributes, None, None
            self.parser.CharacterDataHandler = self._text
        elif tag == "AppendedData":
            layout.appended_encoding = attributes.get("encoding", "base64")
            layout.appended_begin = self.parser.CurrentByteIndex
            raise _AppendedReached

    def _end(self, tag: str) -> None:
        self.stack.pop()
        parent, end = self.stack[-1] if self.stack else "", self.text_end or self.parser.CurrentByteIndex
        if tag == "DataArray" and parent in SECTIONS:
            begin, name = end if self.text_begin is None else self.text_begin, self.attributes.get("Name", "")
            active = bool(name) and self.active == name and parent in ("PointData", "CellData")
            stated, piece = self.attributes.get("NumberOfComponents") or "1", len(self.layout.pieces) - 1
            components = int(stated) if stated.isdecimal() and len(stated) < 10 else 0
            self.layout.arrays.append(
                XmlArray(
                    name, parent == "CellData", active, components, None, parent, piece, self.attributes, begin, end
                )
            )
            self.parser.CharacterDataHandler = None

    def _text(self, text: str) -> None:
        if self.stack[-1] == "DataArray" and not text.isspace():
            self.text_begin = self.parser.CurrentByteIndex
            self.parser.CharacterDataHandler = None


def scan_xml(path: Path, kind: str) -> XmlLayout:
    """Read the XML of the file at `path` up to its appended data."""
    scan, layout = _Scan(), XmlLayout()
    with readable(path), path.open("rb") as file:
        try:
            while chunk := file.read(CHUNK):
                scan.parser.Parse(chunk, False)
            scan.parser.Parse(b"", True)
        except _AppendedReached:
            scan.layout.appended_begin = _after_underscore(file, scan.layout.appended_begin, path)
        except expat.ExpatError as error:
            found = kind_of(start_of(path))
            what = f"truncated or damaged XML: {error}"
            raise DataError(what, where=str(path), found=found, allowed="VTK's XML") from error
        finally:
            layout = scan.layout
            scan.parser.StartElementHandler = scan.parser.EndElementHandler = None  # no reference cycle stays
    stated: Any = layout.file.get("type")
    if stated != kind:
        what = f"not a VTK file of type {kind}"
        raise DataError(what, where=str(path), found=f"type {stated}", allowed=f"VTKFile type {kind}")
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
    """Decoded bytes of base64 text without blanks; four characters hold three bytes."""

    text: Storage
    begin: int
    where: str

    def read_at(self, offset: int, count: int) -> bytes:
        first, last = offset // 3, -(-(offset + count) // 3)
        characters = self.text.read_at(self.begin + 4 * first, 4 * (last - first))
        with explained("damaged base64 text", self.where, binascii.Error):
            decoded = base64.b64decode(characters, validate=True)
        part = decoded[offset - 3 * first : offset - 3 * first + count]
        if len(part) != count:
            raise DataError(f"the base64 text ends {count - len(part)} bytes early", where=self.where)
        return part


class BlockBytes:
    """Blocks of `block_bytes` each (the last may be shorter), compressed separately; the last one read is kept.

    Parameters
    ----------
    begins : the blocks' offsets in `packed`, and the end of the last
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
        with explained(f"block {number} is damaged", self._where):
            block = self._decompress(packed, expected)
        if len(block) != expected:
            what, found = f"block {number} is damaged", f"{len(block)} bytes"
            raise DataError(what, where=self._where, found=found, allowed=expected)
        self._held = number, block
        return block


def decompressor(name: str, where: str) -> Callable[[bytes, int], bytes]:
    """Return the function that decompresses blocks of VTK's compressor `name`."""
    # One byte more than expected detects a block that is too long.
    if name == "vtkZLibDataCompressor":
        return lambda packed, expected: zlib.decompressobj().decompress(packed, expected + 1)
    if name == "vtkLZMADataCompressor":
        return lambda packed, expected: lzma.LZMADecompressor().decompress(packed, expected + 1)
    if name == "vtkLZ4DataCompressor":
        return lambda packed, expected: lz4.block.decompress(packed, uncompressed_size=expected)
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
    characters, padding = 4 * -(-header_bytes // 3), b"=" * (-header_bytes % 3)  # of a text of the header alone
    if isinstance(encoded, Base64Bytes) and bytes(file.read_at(begin, characters)).endswith(padding):
        return Base64Bytes(file, begin + characters, encoded.where), 0
    return encoded, header_bytes if text else begin + header_bytes


def _check_total(found: int, total: int, where: str) -> None:
    if found != total:
        what = "the array's size is not the dataset's"
        raise DataError(what, where=where, found=f"{found} bytes", allowed=f"{total}")


TYPES = {
    f"{kind}{8 * size}": f"{letter}{size}" for kind, letter in (("Int", "i"), ("UInt", "u")) for size in (1, 2, 4, 8)
}
TYPES |= {"Float32": "f4", "Float64": "f8"}
ORDERS = {"LittleEndian": "<", "BigEndian": ">"}
BLANKS = b" \t\r\n"


def stored_dtype(layout: XmlLayout, chosen: XmlArray, where: str) -> np.dtype[Any]:
    kind = chosen.attributes.get("type", "")
    if kind not in TYPES:
        raise DataError("not numbers", where=where, found=f"type {kind}", allowed=", ".join(TYPES))
    return np.dtype(_byte_order(layout, where) + TYPES[kind])


def _byte_order(layout: XmlLayout, where: str) -> str:
    order = layout.file.get("byte_order", "LittleEndian")
    if order not in ORDERS:
        raise DataError("impossible byte_order", where=where, found=order, allowed=", ".join(ORDERS))
    return ORDERS[order]


def storage_of(
    path: Path, size: int, layout: XmlLayout, chosen: XmlArray, stored: np.dtype[Any], count: int, where: str
) -> tuple[Storage, int]:
    """Return the storage of an array of `count` numbers, and the offset of the first of them in it."""
    form = chosen.attributes.get("format", "ascii")
    file = FileBytes([FileRange(path, 0, size)])
    total = count * stored.itemsize
    if form == "ascii":
        return numbers_in_text(path, chosen.text_begin, chosen.text_end, stored, count, where), 0
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


def _begin_of(path: Path, layout: XmlLayout, chosen: XmlArray, form: str, where: str) -> tuple[int, bool]:
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
    with readable(path), path.open("rb") as file:
        file.seek(begin)
        head = file.read(4096)
    return begin + len(head) - len(head.lstrip(BLANKS))


def load_array(path: Path, size: int, layout: XmlLayout, chosen: XmlArray, tuples: int) -> NDArray[Any]:
    """Read an array of `tuples` tuples: (tuples,), or (tuples, components) if it has several components."""
    where = f"{path}:{chosen.name or chosen.section}"
    stored, components = stored_dtype(layout, chosen, where), chosen.components
    shape = (tuples,) if components == 1 else (tuples, components)
    count = tuples * components
    if not count:
        return np.empty(shape, stored.newbyteorder("="))
    storage, offset = storage_of(path, size, layout, chosen, stored, count, where)
    numbers = np.frombuffer(storage.read_at(offset, count * stored.itemsize), stored)
    return numbers.astype(stored.newbyteorder("="), copy=False).reshape(shape)


@dataclass(frozen=True)
class XmlPiece:
    """One piece of a dataset of points and cells, whose arrays are read whole."""

    path: Path
    size: int
    layout: XmlLayout
    number: int

    def count(self, key: str, before: bool = False) -> int:
        """Return a number that the piece states, or the sum of those of the pieces before it."""
        total = 0
        for number in range(self.number) if before else (self.number,):
            text = self.layout.pieces[number].get(key, "0").strip()
            if not text.isdecimal() or len(text) > 18:
                raise DataError(f"impossible {key}", where=str(self.path), found=repr(text), allowed="0 or more")
            total += int(text)
        return total

    def points(self) -> NDArray[Any]:
        found, count = self._find("Points"), self.count("NumberOfPoints")
        if count and (not found or found[0].components != 3):
            raise DataError("a piece has no points", where=str(self.path), allowed="Points of three components")
        return self._load(found[0], count).reshape(-1, 3) if found else np.empty((0, 3), np.float32)

    def cells(self, section: str, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the ends of the section's cells (without the 0 at the beginning), and the indices of their points."""
        if not count:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        offsets = self.array(section, "offsets", count).astype(np.int64).reshape(-1)
        if len(offsets) != count or not 0 <= offsets[-1] < 1 << 60:
            raise DataError(f"the offsets of {section} are wrong", where=str(self.path), found=offsets[-1:].tolist())
        return offsets, self.array(section, "connectivity", int(offsets[-1])).astype(np.int64).reshape(-1)

    def array(self, section: str, name: str, tuples: int) -> NDArray[Any]:
        found = self._find(section, name)
        if not found:
            raise DataError(f"{section} lack an array", where=str(self.path), allowed="connectivity and offsets")
        return self._load(found[0], tuples)

    def has(self, section: str, name: str) -> bool:
        return bool(self._find(section, name))

    def arrays(self, section: str, tuples: int) -> dict[str, NDArray[Any]]:
        numbers = [each for each in self._find(section) if each.attributes.get("type") in TYPES and each.components]
        return {each.name or f"array {number}": self._load(each, tuples) for number, each in enumerate(numbers)}

    def _find(self, section: str, name: str | None = None) -> list[XmlArray]:
        mine = [each for each in self.layout.arrays if each.piece == self.number and each.section == section]
        return [each for each in mine if name in (None, each.name)]

    def _load(self, array: XmlArray, tuples: int) -> NDArray[Any]:
        return load_array(self.path, self.size, self.layout, array, tuples)


def xml_pieces(path: Path, kind: str) -> list[XmlPiece]:
    """Return the pieces of a file of a type, at least one."""
    size, layout = require_file(path), scan_xml(path, kind)
    if not layout.pieces:
        raise DataError("no piece", where=str(path), allowed="<Piece …>")
    return [XmlPiece(path, size, layout, number) for number in range(len(layout.pieces))]
