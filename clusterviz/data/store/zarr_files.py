"""Arrays of Zarr by zarr-python, from files on disk or at a URL; zarr-python is imported here on first use."""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import AsyncIterator, Iterable
from threading import Lock
from time import monotonic
from typing import Any, Literal

from zarr import Array, open_array
from zarr.abc.store import OffsetByteRequest, RangeByteRequest, Store, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype

from clusterviz.data.remote import FilePath, Version, find_range
from clusterviz.errors import DataError

METADATA = ("zarr.json", ".zarray", ".zattrs", ".zgroup", ".zmetadata")
MOST_CHUNK_BYTES = 1 << 32
"""Samples of a chunk."""
CHECKED_SECONDS = 1.0
"""How often it is checked that the array is still there, where chunks are missing."""
_INSTALL = {"imagecodecs": "imagecodecs", "pcodec": "pcodec", "zfpy": "zfpy", "wavpack": "wavpack-numcodecs"}


def open_zarr(path: FilePath, zarr_format: Literal[2, 3]) -> Array[Any]:
    """Open an array for reading.

    Raises
    ------
    DataError
        Not an array, a codec that is not installed, or chunks too large to be read.
    """
    where = str(path)
    try:
        opened = open_array(ZarrFiles(path), mode="r", zarr_format=zarr_format)
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
    return opened


class ZarrFiles(Store):
    """Files of an array for zarr-python; a file that was changed since it was first read is an error."""

    supports_writes = supports_deletes = supports_listing = False

    def __init__(self, path: FilePath) -> None:
        super().__init__(read_only=True)
        self._path, self._lock = path, Lock()
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
        found = find_range(self._path / key, begin, count, known)
        if found is None:
            if key in self._versions:
                raise DataError("the file was removed while it was in use", where=str(self._path / key))
            if key not in METADATA:
                self._check_array()
            return None
        with self._lock:
            self._versions.setdefault(key, found[1])
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
        """Return the bytes of a file; None if it is missing."""
        data = await asyncio.to_thread(self._find, key, byte_range)
        return None if data is None else (prototype or default_buffer_prototype()).buffer.from_bytes(data)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, Any]]
    ) -> list[Buffer | None]:
        """Return the bytes of parts of files."""
        return list(await asyncio.gather(*(self.get(key, prototype, wanted) for key, wanted in key_ranges)))

    async def exists(self, key: str) -> bool:
        """Return whether there is a file."""
        return await self.get(key, byte_range=RangeByteRequest(0, 1)) is not None

    async def set(self, key: str, value: Buffer) -> None:
        """Refuse to write."""
        self._check_writable()

    async def delete(self, key: str) -> None:
        """Refuse to write."""
        self._check_writable()

    def list(self) -> AsyncIterator[str]:
        """Refuse to list files, which servers do not."""
        raise NotImplementedError("files of a server are not listed")

    def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        """Refuse to list files."""
        return self.list()

    def list_dir(self, prefix: str) -> AsyncIterator[str]:
        """Refuse to list files."""
        return self.list()
