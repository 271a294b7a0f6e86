"""Encoding of arrays in .vti files: base64 text, and separately compressed blocks."""

from __future__ import annotations

import base64
import binascii
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from itertools import accumulate
from typing import Any

import numpy as np

from clusterviz.data.header import check_packed
from clusterviz.data.storage import Storage
from clusterviz.errors import DataError

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
