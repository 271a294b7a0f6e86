"""Arrays of Zarr by zarr-python, from files on disk or at a URL; zarr-python is imported here on first use."""

from __future__ import annotations

import asyncio
import bz2
import gzip
import math
import re
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import takewhile
from threading import Lock
from time import monotonic
from typing import Any, Literal

import numpy as np
from zarr import Array, open_array
from zarr.abc.store import OffsetByteRequest, RangeByteRequest, Store, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype
from zarr.core.sync import sync

from clusterviz.data.header import MAX_COMPRESSION_RATIO
from clusterviz.data.remote import FilePath, Version, find_range
from clusterviz.data.storage import Inflated
from clusterviz.errors import DataError

METADATA = ("zarr.json", ".zarray", ".zattrs", ".zgroup", ".zmetadata")
MOST_CHUNK_BYTES = 1 << 32
"""Samples of a chunk."""
HARMLESS_BYTES = 1 << 28
"""Deflated chunks that cannot hold more are not unpacked to count their bytes, which takes as long as to read them."""
CHECKED_SECONDS = 1.0
"""How often it is checked that the array is still there, where chunks are missing."""
_INSTALL = {"imagecodecs": "imagecodecs", "pcodec": "pcodec", "zfpy": "zfpy", "wavpack": "wavpack-numcodecs"}


def open_zarr(path: FilePath, zarr_format: Literal[2, 3]) -> Array[Any]:
    where = str(path)
    files = ZarrFiles(path)
    try:
        opened = open_array(files, mode="r", zarr_format=zarr_format)
    except Exception as error:
        if type(error).__name__ != "UnknownCodecError":
            raise
        codec = (re.findall(r"'([^']+)'", str(error)) or [str(error)])[-1]
        package = next((package for name, package in _INSTALL.items() if codec.startswith(name)), None)
        allowed = f"pip install {package}" if package else "codecs of numcodecs and of installed packages"
        raise DataError("a codec that is not installed", where=where, found=codec, allowed=allowed) from error
    chunk = math.prod(opened.chunks) * opened.dtype.itemsize
    if not 0 < chunk <= MOST_CHUNK_BYTES or math.prod(opened.shape) * opened.dtype.itemsize >= 1 << 63:
        found, allowed = (
            f"{opened.shape}, chunks {opened.chunks}",
            f"chunks of 1 sample to {MOST_CHUNK_BYTES >> 30} GiB",
        )
        raise DataError("impossible size", where=where, found=found, allowed=allowed)
    files.chunks = _packing(opened.metadata.to_dict(), chunk)
    bytes_of_file = math.prod(opened.shards or opened.chunks) * opened.dtype.itemsize
    files.most_bytes = min(_most_bytes(bytes_of_file) + files.chunks.shard, 1 << 62)
    return opened


def read_array(array: Any, box: tuple[slice, ...]) -> Any:
    """Return a box of an array; if a chunk fails, after all other reading of chunks has ended."""
    try:
        return array[box]
    except BaseException:
        # zarr-python leaves its other tasks behind, which would complain when the process ends.
        sync(_end_tasks())
        raise


async def _end_tasks() -> None:
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


@dataclass(frozen=True)
class _Packing:
    """How the chunks in a file are packed, as far as it tells how many bytes they take when unpacked.

    Attributes
    ----------
    codecs : those that pack bytes or check them, in the order in which they are undone
    most_bytes : of a chunk
    shard : bytes of the index of a file, which is a shard; 0: a file is a chunk
    is_first : whether the index is at the beginning of the file
    """

    codecs: tuple[str, ...]
    most_bytes: int
    shard: int = 0
    is_first: bool = False

    def check(self, data: bytes, is_part: bool, where: str) -> None:
        """Check what is read of a file: all of it, or a part, which is a chunk or the index of a shard."""
        if not self.shard or is_part:
            if self.codecs and len(data) != self.shard:
                self._check_chunk(data, where)
            return
        stored = (data[: self.shard] if self.is_first else data[-self.shard :])[: self.shard // 16 * 16]
        index = np.frombuffer(stored[: len(stored) // 16 * 16], "<u8").reshape(-1, 2)
        for offset, count in index[index[:, 0] < len(data)].tolist():
            self._check_chunk(data[offset : offset + count], where)

    def _check_chunk(self, data: bytes, where: str) -> None:
        for codec in self.codecs:
            found, unpacked = 0, b""
            with suppress(Exception):  # damaged: zarr-python says so
                if codec == "crc32c":
                    data = data[:-4]
                    continue
                is_last = codec == self.codecs[-1]
                if (
                    codec in ("gzip", "zlib")
                    and len(data) * MAX_COMPRESSION_RATIO["gzip"] <= HARMLESS_BYTES
                    and is_last
                ):
                    return
                found = _DECLARED[codec](data) if codec in _DECLARED else -1
                if codec in _STREAMS and (found < 0 or not is_last):
                    stream, parts, found = _STREAMS[codec](data), list[bytes](), 0
                    while found <= self.most_bytes and (part := stream.read(1 << 20)):
                        found += len(part)
                        parts += [] if is_last else [part]
                    unpacked = b"".join(parts)
            if found > self.most_bytes:
                raise DataError(
                    "a chunk is larger than the array says", where=where, allowed=f"{self.most_bytes} bytes"
                )
            if not unpacked:
                return
            data = unpacked


def _most_bytes(chunk_bytes: int) -> int:
    """Return the most that a codec may make of the samples of a chunk: a bit more, where they cannot be packed."""
    return chunk_bytes + chunk_bytes // 256 + (1 << 16)


def _packing(metadata: Any, chunk_bytes: int) -> _Packing:
    if metadata["zarr_format"] == 2:
        found = [*(metadata.get("filters") or []), *filter(None, [metadata.get("compressor")])]
        return _Packing(_compressors(each["id"] for each in found[::-1]), _most_bytes(chunk_bytes))
    codecs, shard, is_first = metadata["codecs"], 0, False
    if codecs[-1]["name"] == "sharding_indexed":
        inner = codecs[-1]["configuration"]
        sides = zip(metadata["chunk_grid"]["configuration"]["chunk_shape"], inner["chunk_shape"], strict=True)
        count = math.prod(side // part for side, part in sides)
        has_sum = any(each["name"] == "crc32c" for each in inner["index_codecs"])
        codecs, shard = inner["codecs"], 16 * count + 4 * has_sum
        is_first = inner.get("index_location") == "start"
    names = _compressors(each["name"].removeprefix("numcodecs.") for each in codecs[::-1])
    return _Packing(names, _most_bytes(chunk_bytes), shard, is_first)


def _compressors(codecs: Iterable[str]) -> tuple[str, ...]:
    """Return the codecs before the first one that neither packs bytes nor adds a checksum."""
    return tuple(takewhile(lambda codec: codec in _DECLARED or codec in _STREAMS or codec == "crc32c", codecs))


def _zstd_bytes(data: bytes) -> int:
    import zstandard  # which may be missing

    return int(zstandard.frame_content_size(data))


def _zstd_stream(data: bytes) -> Any:
    import zstandard  # which may be missing

    return zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)


_DECLARED: dict[str, Callable[[bytes], int]] = {
    "blosc": lambda data: int.from_bytes(data[4:8], "little"),
    "lz4": lambda data: int.from_bytes(data[:4], "little"),
    "zstd": _zstd_bytes,
}
"""Functions that return the bytes that packed data say they hold, on which their decoders rely; −1: they do not say."""
_STREAMS: dict[str, Callable[[bytes], Any]] = {
    "zstd": _zstd_stream,
    "gzip": lambda data: gzip.GzipFile(fileobj=BytesIO(data)),
    "zlib": lambda data: Inflated(BytesIO(data), 47),
    "bz2": lambda data: bz2.BZ2File(BytesIO(data)),
}
"""Functions that return packed data as a stream, which is read to count its bytes."""


class ZarrFiles(Store):
    """Files of an array for zarr-python; a file that was changed since it was first read is an error."""

    supports_writes = supports_deletes = supports_listing = False

    def __init__(self, path: FilePath) -> None:
        super().__init__(read_only=True)
        self._path, self._lock = path, Lock()
        self.chunks: _Packing | None = None
        self.most_bytes: int | None = None
        self._versions: dict[str, Version] = {}
        self._checked = 0.0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ZarrFiles) and self._path == other._path

    def __hash__(self) -> int:
        return hash(str(self._path))

    def __str__(self) -> str:
        return str(self._path)

    def _find(self, key: str, wanted: Any) -> bytes | None:
        begin, count = 0, None
        if isinstance(wanted, RangeByteRequest):
            begin, count = wanted.start, wanted.end - wanted.start
        elif isinstance(wanted, OffsetByteRequest):
            begin = wanted.offset
        elif isinstance(wanted, SuffixByteRequest):
            begin = -wanted.suffix
        known = self._versions.get(key)
        found = find_range(self._path / key, begin, count, known, most=None if key in METADATA else self.most_bytes)
        if found is None:
            if key in self._versions:
                raise DataError("the file was removed while it was in use", where=str(self._path / key))
            if key not in METADATA:
                self._check_array()
            return None
        with self._lock:
            self._versions.setdefault(key, found[1])
        if self.chunks and key not in METADATA:
            self.chunks.check(found[0], wanted is not None, str(self._path / key))
        return found[0]

    def _check_array(self) -> None:
        """Check that the array's description is as it was, since absent chunks would be taken for empty ones."""
        if monotonic() - self._checked < CHECKED_SECONDS:
            return
        for key in set(METADATA) & self._versions.keys():
            if find_range(self._path / key, 0, None, self._versions[key], fresh=True) is None:
                raise DataError("the store was removed while it was in use", where=str(self._path))
        self._checked = monotonic()

    async def get(self, key: str, prototype: BufferPrototype | None = None, byte_range: Any = None) -> Buffer | None:
        data = await asyncio.to_thread(self._find, key, byte_range)
        return None if data is None else (prototype or default_buffer_prototype()).buffer.from_bytes(data)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, Any]]
    ) -> list[Buffer | None]:
        return list(await asyncio.gather(*(self.get(key, prototype, wanted) for key, wanted in key_ranges)))

    async def exists(self, key: str) -> bool:
        return await self.get(key, byte_range=RangeByteRequest(0, 1)) is not None

    async def set(self, key: str, value: Buffer) -> None:
        self._check_writable()

    async def delete(self, key: str) -> None:
        self._check_writable()

    def list(self) -> AsyncIterator[str]:
        raise NotImplementedError("files of a server are not listed")

    def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        return self.list()

    def list_dir(self, prefix: str) -> AsyncIterator[str]:
        return self.list()
