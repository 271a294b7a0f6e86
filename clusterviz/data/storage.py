"""Byte storage behind the formats: files, compressed streams and text.

The opener of a format locates its samples in a `Storage`, from which `StridedSource` reads boxes. Storages nest: zlib
blocks in base64 text in a file. Detached data of NRRD and MetaImage are files with numbered names and equal shares.
"""

from __future__ import annotations

import os
import re
import weakref
import zlib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab
from clusterviz.data.files import explained, readable
from clusterviz.data.header import check_box, check_dtype, check_packed, check_size
from clusterviz.data.source import Grid, Index
from clusterviz.errors import DataError

CHUNK = 1 << 20  # bytes decoded at a time
MAX_FILES = 1 << 16
NUMBERED = re.compile(r"([^\s%]*%0?\d?\d?d[^\s%]*) +(-?\d+) +(-?\d+) +(-?\d+)( +\d+)?")


class Storage(Protocol):
    """Sequence of bytes.

    `read_at(offset, count)` returns exactly `count` bytes, or raises `DataError` if they end early or cannot be
    decoded.
    """

    def read_at(self, offset: int, count: int) -> bytes | memoryview: ...


@dataclass(frozen=True)
class FileRange:
    """`count` bytes of a file from `begin`."""

    path: Path
    begin: int
    count: int


class FileBytes:
    """Ranges of files, one after another; only the requested bytes are read, and one file is open at a time."""

    def __init__(self, pieces: Sequence[FileRange]) -> None:
        self._pieces = tuple(pieces)
        self._open_path: Path | None = None
        self._descriptor = -1
        self._close: Callable[[], object] = lambda: None

    def read_at(self, offset: int, count: int) -> bytes:
        parts = []
        for piece in self._pieces:
            if count and offset < piece.count:
                part = min(count, piece.count - offset)
                parts.append(self._read(piece.path, piece.begin + offset, part))
                offset, count = offset + part, count - part
            offset -= piece.count
        if count:
            raise DataError(f"the data ends {count} bytes early", where=str(self._pieces[-1].path))
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _read(self, path: Path, offset: int, count: int) -> bytes:
        parts = []
        with readable(path):
            if path != self._open_path:
                self._close()
                self._descriptor = os.open(path, os.O_RDONLY)
                self._open_path = path
                self._close = weakref.finalize(self, os.close, self._descriptor)
            while count:  # one pread returns at most 2 GiB
                part = os.pread(self._descriptor, count, offset)
                if not part:
                    raise DataError(f"the file ends {count} bytes early", where=str(path))
                parts.append(part)
                offset, count = offset + len(part), count - len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)


class StreamBytes:
    """Compressed bytes that can only be decoded in order.

    The last `keep` bytes are kept, so that boxes that overlap by a layer need no second pass. A request before them
    decodes the file again from the start.

    Parameters
    ----------
    decoder : wraps the file, positioned at `start`, in a stream of decoded bytes: `gzip.open`, `bz2.open`
    keep : number of decoded bytes to keep
    """

    def __init__(self, path: Path, decoder: Callable[[Any], Any], start: int = 0, keep: int = 0) -> None:
        self._path, self._decoder, self._start, self.keep = path, decoder, start, keep
        self._chunks: deque[bytes] = deque()
        self._first = self._last = 0  # the decoded bytes [first, last) are in the chunks
        self._stream: Any = None
        self._close: Callable[[], object] = lambda: None

    def read_at(self, offset: int, count: int) -> bytes:
        if self._stream is None or offset < self._first:
            self._restart()
        unneeded = min(offset, offset + count - self.keep)
        while self._last < offset + count:
            self._advance(unneeded)
        parts, begin = [], self._first
        for chunk in self._chunks:
            parts.append(chunk[max(0, offset - begin) : max(0, offset + count - begin)])
            begin += len(chunk)
        return b"".join(parts)

    def _restart(self) -> None:
        self._close()
        with readable(self._path):
            file = self._path.open("rb")
            file.seek(self._start)
        self._close = weakref.finalize(self, file.close)
        self._stream = self._decoder(file)
        self._chunks.clear()
        self._first = self._last = 0

    def _advance(self, unneeded: int) -> None:
        try:
            chunk = self._stream.read(CHUNK)
        except (OSError, EOFError, zlib.error) as error:
            self._stream = None
            raise DataError(f"the compressed data is damaged or truncated: {error}", where=str(self._path)) from error
        if not chunk:
            raise DataError(f"truncated: only {self._last} bytes when decompressed", where=str(self._path))
        self._chunks.append(chunk)
        self._last += len(chunk)
        while self._chunks and self._first + len(self._chunks[0]) <= unneeded:
            self._first += len(self._chunks.popleft())


class Inflated:
    """Stream of decoded bytes of a deflated file.

    Parameters
    ----------
    window : `wbits` of `zlib.decompressobj`: −15 for deflate without a header, 47 for zlib or gzip
    checksum : number of decoded bytes and their CRC-32, for streams without one
    """

    def __init__(self, file: Any, window: int, checksum: tuple[int, int] | None = None) -> None:
        self._file, self._decoder, self._checksum = file, zlib.decompressobj(window), checksum
        self._count = self._crc = 0

    def read(self, count: int) -> bytes:
        """Read at most `count` bytes; none at the end."""
        while not self._decoder.eof:
            packed = self._decoder.unconsumed_tail or self._file.read(CHUNK)
            decoded = self._decoder.decompress(packed, count)
            if decoded:
                self._count, self._crc = self._count + len(decoded), zlib.crc32(decoded, self._crc)
                if self._checksum and self._count >= self._checksum[0] and (self._count, self._crc) != self._checksum:
                    raise zlib.error("wrong checksum")
                return decoded
            if not packed:
                raise EOFError("the file ends early")
        return b""


class LoadedBytes:
    """Bytes decoded as a whole on first use, for encodings without offsets (numbers written as text)."""

    def __init__(self, load: Callable[[], bytes], where: str) -> None:
        self._load, self._where = load, where
        self._bytes: bytes | None = None

    def read_at(self, offset: int, count: int) -> memoryview:
        if self._bytes is None:
            self._bytes = self._load()
        if offset + count > len(self._bytes):
            raise DataError("the data ends early", where=self._where, found=f"{len(self._bytes)} bytes")
        return memoryview(self._bytes)[offset : offset + count]


MAX_WORD = 400  # characters of a number


def numbers_of_words(words: Sequence[bytes], dtype: type[np.float64] | type[np.int64]) -> NDArray[Any]:
    """Return words as numbers.

    Raises
    ------
    ValueError
        A word is no number.
    """
    longest = max(map(len, words), default=0)
    if longest > MAX_WORD:  # each word takes the memory of the longest
        raise ValueError(f"a word of {longest} characters")
    return np.array(words, "S").astype(dtype)


def numbers_from_text(text: bytes, dtype: np.dtype[Any], count: int, where: str) -> bytes:
    """Return the bytes of `count` numbers of type `dtype`, separated by blanks or commas in `text`."""
    words = text.replace(b",", b" ").split()
    if len(words) != count:
        raise DataError("the header lies about its size", where=where, found=f"{len(words)} numbers", allowed=count)
    with explained(f"not a number of type {dtype}", where, ValueError, OverflowError):
        if dtype.kind == "f":
            return numbers_of_words(words, np.float64).astype(dtype).tobytes()
        return np.array([int(word) for word in words], dtype).tobytes()


def numbers_in_text(path: Path, begin: int, end: int, stored: np.dtype[Any], count: int, where: str) -> LoadedBytes:
    """Return the bytes of `count` numbers in the text of a file between two of its bytes."""
    check_packed(end - begin, count, "text", where)
    text = FileBytes([FileRange(path, begin, end - begin)])
    return LoadedBytes(lambda: numbers_from_text(text.read_at(0, end - begin), stored, count, where), where)


def numbered_names(entry: str, where: str) -> list[str]:
    """Return the files that `entry` names: those of "name%03d.raw first last step", or the one of this name."""
    pattern = NUMBERED.fullmatch(entry)
    if not pattern:
        return [entry]
    first, last, step = (int(pattern[i]) for i in (2, 3, 4))
    numbers = range(first, last + (1 if step > 0 else -1), step or 1)
    if step == 0 or max(map(abs, (first, last, step))) >> 62 or len(numbers) > MAX_FILES:
        allowed = f"first, last and a step other than 0 for at most {MAX_FILES} files"
        raise DataError("impossible data file", where=where, found=entry, allowed=allowed)
    return [pattern[1] % number for number in numbers]


def file_ranges(
    files: Sequence[Path], sizes: Sequence[int], begins: Sequence[int], skip: int, needed: int
) -> list[FileRange]:
    """Return one range a file; each file must hold exactly an equal share of the samples.

    Parameters
    ----------
    sizes, begins : bytes in each file, and before its data
    skip : further bytes before the data; −1: the data ends with the file
    needed : bytes in all ranges together
    """
    share = needed // len(files)
    pieces = []
    for file, size, begin in zip(files, sizes, begins, strict=True):
        start = size - share if skip == -1 else begin + skip
        check_size(size, start + share if start >= 0 else share, str(file), exact=True)
        pieces.append(FileRange(file, start, share))
    check_size(share * len(files), needed, str(files[0]))
    return pieces


MAX_READ_GAP = 4096  # bytes between two rows that are read rather than skipped by a second request


@dataclass(frozen=True)
class StridedSource:
    """Samples at constant strides.

    Attributes
    ----------
    storage : of the bytes
    stored_dtype : dtype in the file, with its byte order
    offset : bytes before the first sample
    strides : bytes from one sample to the next along z, y, x; by default contiguous, x fastest
    scale : (slope, intercept) applied to every sample, or None
    slab : the volume's part of an array with more axes, or None
    """

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    storage: Storage
    stored_dtype: np.dtype[Any]
    offset: int = 0
    strides: Index | None = None
    scale: tuple[float, float] | None = None
    slab: Hyperslab | None = None

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of a box, plane by plane in the order of the file; see `Source.read`."""
        box = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        _, y, x = self.grid.shape_zyx
        item = self.stored_dtype.itemsize
        strides = self.strides or (y * x * item, x * item, item)
        axes = sorted(range(3), key=lambda axis: -strides[axis])  # slowest first
        slow_bytes, row_bytes, sample_bytes = (strides[axis] for axis in axes)
        stored = np.empty([box[axis] for axis in axes], self.stored_dtype)
        if stored.size:
            begin = self.offset + sum(b * stride for b, stride in zip(begin_zyx, strides, strict=True))
            for i, plane in enumerate(stored):
                self._read_plane(begin + i * slow_bytes, row_bytes, sample_bytes, plane)
        return self._finish(stored.transpose(np.argsort(axes)))

    def _read_plane(self, begin: int, row_bytes: int, sample_bytes: int, plane: NDArray[Any]) -> None:
        """Fill `plane` (rows, columns) with the samples from byte `begin`."""
        rows, columns = plane.shape
        line_bytes = (columns - 1) * sample_bytes + self.stored_dtype.itemsize
        if rows > 1 and row_bytes - line_bytes > MAX_READ_GAP:
            for i, row in enumerate(plane):
                line = self.storage.read_at(begin + i * row_bytes, line_bytes)
                row[:] = np.ndarray(columns, self.stored_dtype, line, strides=(sample_bytes,))
            return
        span = self.storage.read_at(begin, (rows - 1) * row_bytes + line_bytes)
        plane[:] = np.ndarray(plane.shape, self.stored_dtype, span, strides=(row_bytes, sample_bytes))

    def _finish(self, stored: NDArray[Any]) -> NDArray[Any]:
        if self.scale is not None:
            slope, intercept = self.scale
            return np.ascontiguousarray(stored * np.float64(slope) + np.float64(intercept), self.dtype)
        return np.ascontiguousarray(stored, self.dtype)


def slab_source(
    where: str,
    slab: Hyperslab,
    grid: Grid,
    storage: Storage,
    stored: np.dtype[Any],
    begin: int = 0,
    fortran: bool = False,
) -> StridedSource:
    """Return the volume in an array that begins with byte `begin` of a storage."""
    dtype, (offset, strides) = check_dtype(stored, where), slab.strides(stored.itemsize, fortran)
    return StridedSource(where + slab.label, grid, dtype, storage, stored, begin + offset, strides, slab=slab)
