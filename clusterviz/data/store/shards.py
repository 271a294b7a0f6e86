"""Arrays of bricks as Zarr 3 stores them: files (shards) of many bricks, with an index and checksums.

A shard holds a cube of bricks, one after another, each with its CRC-32C, then for each the offset and the length, and
the CRC-32C of these. A brick that does not fit into the array is padded. zarr-python takes about a millisecond for each
brick, so the arrays that clusterviz writes are read here.

The minima, maxima and errors of the bricks of a shard are a file with a CRC-32C, but not in stores of version 1.

An array may have axes of time and channels before z, with shards and bricks of 1 along them. The bytes of a brick may
say that its samples are those of another time step.

References
----------
Zarr core specification 3.1; codecs sharding_indexed, crc32c, bytes; zarr-specs.readthedocs.io.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from threading import Lock
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import Box
from clusterviz.data.files import explained, library
from clusterviz.data.header import check_box
from clusterviz.data.remote import CONNECTIONS, FilePath, Version, read_range
from clusterviz.data.source import Index, as_index
from clusterviz.data.store import zfp
from clusterviz.data.store.cache import CACHE, Owner, for_each
from clusterviz.data.store.wavelet import (
    EFFORT,
    MOST_EFFORT,
    compress,
    decode_brick,
    decompress,
    encode_brick,
    referred_step,
)
from clusterviz.errors import DataError, InputError
from clusterviz.image.replace import replacing

SHARD_BYTES = 32 << 20
"""Samples of a shard, at most, unless a brick is larger."""
MOST_SIDE, MOST_BRICKS = 512, 1 << 27
"""Of bricks that are read: samples along a side, and their number in a level."""
PACKAGES = ("zstandard", "google_crc32c")
"""What bricks and their checksums need."""
CODECS = ("wavelet", "zstd", "zfp")
_LITTLE = {"name": "bytes", "configuration": {"endian": "little"}}
_CRC = {"name": "crc32c"}
_CRC_BYTES = 4
_ABSENT = (1 << 64) - 1


@dataclass(frozen=True)
class BrickCodec:
    """How a brick becomes bytes.

    Attributes
    ----------
    name : one of `CODECS`
    error : largest difference of a sample; 0 with zstd
    effort : level of zstd; zfp has none
    """

    name: str = "wavelet"
    error: float = 0.0
    effort: int = EFFORT

    def __post_init__(self) -> None:
        if self.name not in CODECS:
            raise InputError("no such codec", where="codec", found=self.name, allowed=", ".join(CODECS))
        if not (0 <= self.error < math.inf) or (self.error > 0 and self.name == "zstd"):
            allowed = "0; more with wavelets or zfp"
            raise InputError("impossible error", where="error", found=self.error, allowed=allowed)
        if not 1 <= self.effort <= MOST_EFFORT:
            raise InputError("no such level of zstd", where="effort", found=self.effort, allowed=f"1 to {MOST_EFFORT}")

    def require(self, where: str) -> None:
        if self.name == "zfp":
            library("zfpy", "zfp", where)

    def check(self, dtype: np.dtype[Any]) -> None:
        if self.name != "zfp":
            return
        self.require("codec")
        if dtype.name not in zfp.DTYPES:
            allowed = f"{', '.join(zfp.DTYPES)}; wavelet for others"
            raise InputError("zfp does not pack this type", where="codec", found=dtype.name, allowed=allowed)
        if self.error > 0 and dtype.kind != "f":
            text = "zfp bounds the error of floats only"
            raise InputError(text, where="error", found=self.error, allowed="0; --codec wavelet")

    def encode(self, samples: NDArray[Any]) -> bytes:
        if self.name == "wavelet":
            return encode_brick(samples, self.error, self.effort)
        if self.name == "zfp":
            return zfp.encode_brick(samples, self.error)
        return compress(np.ascontiguousarray(samples), self.effort)

    def decode(self, data: bytes, shape: Index, dtype: np.dtype[Any], where: str) -> NDArray[Any]:
        if self.name == "wavelet":
            return decode_brick(data, shape, dtype, where)
        if self.name == "zfp":
            return zfp.decode_brick(data, shape, dtype, where)
        samples = decompress(memoryview(data), math.prod(shape) * dtype.itemsize, where)
        return np.frombuffer(samples, dtype.newbyteorder("<")).astype(dtype, copy=False).reshape(shape)

    @property
    def metadata(self) -> list[dict[str, Any]]:
        if self.name == "wavelet":
            configuration = {"error": self.error, "effort": self.effort}
            return [{"name": "clusterviz.wavelet", "configuration": configuration}, _CRC]
        if self.name == "zfp":
            return [zfp.metadata(self.error), _CRC]
        return [_LITTLE, {"name": "zstd", "configuration": {"level": self.effort, "checksum": False}}, _CRC]


@dataclass(frozen=True)
class ShardedArray:
    """Array of bricks in a folder; if it has several time steps or channels, one of its volumes.

    Attributes
    ----------
    path : of the folder; a `RemotePath` of what is only read
    brick_zyx : samples of a brick
    shard_zyx : bricks of a shard
    axes : letters of the axes before z: t, c, both, or none
    counts : time steps and channels, along these axes
    index : of the volume along these axes
    check : raises `DataError` if the store was changed since it was opened
    has_checksums : whether the files of statistics have one; not in stores of version 1
    """

    path: Path
    shape_zyx: Index
    brick_zyx: Index
    shard_zyx: Index
    dtype: np.dtype[Any]
    codec: BrickCodec
    axes: str = ""
    counts: tuple[int, ...] = ()
    index: tuple[int, ...] = ()
    check: Callable[[], None] = field(default=lambda: None, compare=False, repr=False)
    has_checksums: bool = True
    _indices: dict[tuple[int, ...], tuple[NDArray[np.uint64], Version]] = field(
        default_factory=dict, compare=False, repr=False
    )
    _lock: Lock = field(default_factory=Lock, compare=False, repr=False)
    _owner: Owner = field(default_factory=Owner, compare=False, repr=False)

    def at(self, *index: int) -> ShardedArray:
        """Return another volume of the array; they share what is kept in memory."""
        return replace(self, index=index)

    def at_step(self, step: int) -> ShardedArray:
        return self.at(step, *self.index[1:])

    @property
    def step(self) -> int:
        """Number of the time step; 0 without such an axis."""
        return self.index[0] if self.axes.startswith("t") else 0

    @property
    def counts_zyx(self) -> Index:
        return _quotients(self.shape_zyx, self.brick_zyx)

    @property
    def shards_zyx(self) -> Index:
        return _quotients(self.counts_zyx, self.shard_zyx)

    @property
    def shards(self) -> list[Index]:
        return _indices(self.shards_zyx)

    @property
    def metadata(self) -> dict[str, Any]:
        sharding = {
            "chunk_shape": [*self._ones, *self.brick_zyx],
            "codecs": self.codec.metadata,
            "index_codecs": [_LITTLE, _CRC],
            "index_location": "end",
        }
        sides = [brick * shard for brick, shard in zip(self.brick_zyx, self.shard_zyx, strict=True)]
        codecs = [{"name": "sharding_indexed", "configuration": sharding}]
        shape, chunk = (*self.counts, *self.shape_zyx), (*self._ones, *sides)
        return array_metadata(shape, chunk, self.dtype, codecs, [*self.axes, *"zyx"])

    @property
    def _ones(self) -> tuple[int, ...]:
        return (1,) * len(self.counts)

    @property
    def statistics_metadata(self) -> dict[str, Any]:
        names = ["minimum", "maximum", "error", "step"][: self._rows]
        shape, chunk = (*self.counts, self._rows, *self.counts_zyx), (*self._ones, self._rows, *self.shard_zyx)
        axes = [*self.axes, ", ".join(names), *"zyx"]
        return array_metadata(shape, chunk, np.dtype(np.float64), [_LITTLE, _CRC], axes)

    @property
    def _rows(self) -> int:
        return 4 if "t" in self.axes else 3

    def shard_path(self, shard: Index) -> Path:
        return self.path.joinpath("c", *map(str, (*self.index, *shard)))

    def statistics_path(self, shard: Index) -> Path:
        return self.path.parent.joinpath("bricks", self.path.name, "c", *map(str, (*self.index, 0, *shard)))

    def write_statistics(self, shard: Index, found: Mapping[Index, Sequence[float]]) -> None:
        """Write the statistics of a shard's bricks: for each minimum, maximum, error, and the step of its samples."""
        values = np.zeros((self._rows, *self.shard_zyx))
        for brick, each in found.items():
            z, y, x = (i % n for i, n in zip(brick, self.shard_zyx, strict=True))
            values[:, z, y, x] = each[: self._rows]
        path, data = self.statistics_path(shard), values.astype("<f8").tobytes()
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_bytes(data + checksum(data))

    @property
    def summary_path(self) -> Path:
        """Path of the file with the summary of the volume whose finest level this is."""
        return self.path.parent / "bricks" / f"{'-'.join(map(str, ('statistics', *self.index)))}.npz"

    def statistics(self) -> NDArray[np.float64]:
        """Return minimum, maximum and error of the bricks, float64 (3, z, y, x bricks); see `writer.py`."""
        return self._statistics()[:3]

    def steps(self) -> NDArray[np.int64]:
        """Return for each brick the first time step from which on its samples are the same, int64 (z, y, x bricks).

        Raises as `statistics`.
        """
        found = self._statistics()[3:]
        return found[0].astype(np.int64) if len(found) else np.zeros(self.counts_zyx, np.int64)

    def _statistics(self) -> NDArray[np.float64]:
        rows, (nz, ny, nx) = self._rows, self.shard_zyx
        values = np.empty((rows, *(s * n for s, n in zip(self.shards_zyx, self.shard_zyx, strict=True))))
        for z, y, x in self.shards:
            path = self.statistics_path((z, y, x))
            data, _ = read_range(path)
            data, found = (data[:-_CRC_BYTES], data[-_CRC_BYTES:]) if self.has_checksums else (data, b"")
            if len(data) != 8 * rows * nz * ny * nx:
                raise DataError("damaged statistics of bricks", where=str(path), found=f"{len(data)} bytes")
            if self.has_checksums and checksum(data) != found:
                raise DataError("statistics of bricks have a wrong checksum: damaged", where=str(path))
            here = values[:, z * nz : (z + 1) * nz, y * ny : (y + 1) * ny, x * nx : (x + 1) * nx]
            here[...] = np.frombuffer(data, "<f8").reshape(here.shape)
        nz, ny, nx = self.counts_zyx
        return values[:, :nz, :ny, :nx]

    def bricks_of(self, shard: Index) -> list[Index]:
        ranges = [
            range(s * n, min((s + 1) * n, count))
            for s, n, count in zip(shard, self.shard_zyx, self.counts_zyx, strict=True)
        ]
        return [(z, y, x) for z, y, x in product(*ranges)]

    def box_of(self, brick: Index) -> Box:
        """Return the samples of a brick that lie in the array, half-open."""
        z, y, x = (i * side for i, side in zip(brick, self.brick_zyx, strict=True))
        end = (min(n, i + side) for n, i, side in zip(self.shape_zyx, (z, y, x), self.brick_zyx, strict=True))
        z_end, y_end, x_end = end
        return (z, y, x), (z_end, y_end, x_end)

    def encode(self, samples: NDArray[Any]) -> bytes:
        """Return the samples of a brick as bytes; the last ones along an axis are repeated to its full size."""
        missing = [(0, side - n) for side, n in zip(self.brick_zyx, samples.shape, strict=True)]
        return self.codec.encode(np.pad(samples, missing, mode="edge") if any(n for _, n in missing) else samples)

    def write_shard(self, shard: Index, bricks: Iterable[tuple[Index, bytes]]) -> None:
        """Write the encoded bricks of a shard; the file appears when it is complete.

        Raises
        ------
        OutputError
            It cannot be written.
        """
        path = self.shard_path(shard)
        path.parent.mkdir(parents=True, exist_ok=True)
        index, at = np.full((math.prod(self.shard_zyx), 2), _ABSENT, "<u8"), 0
        with replacing(path) as temporary, temporary.open("wb") as file:
            for brick, data in bricks:
                index[self._slot(brick)] = at, len(data) + _CRC_BYTES
                file.write(data + checksum(data))
                at += len(data) + _CRC_BYTES
            file.write(index.tobytes() + checksum(index.tobytes()))

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        return self.read_boxes([(begin_zyx, end_zyx)])[0]

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]]:
        """Read the samples of several boxes; each brick is decoded once, several at a time."""
        read = [np.empty(check_box(*box, self.shape_zyx), self.dtype) for box in boxes]
        users: dict[Index, list[int]] = defaultdict(list)
        for number, (box, samples) in enumerate(zip(boxes, read, strict=True)):
            ranges = [range(b // side, -(-e // side)) for b, e, side in zip(*box, self.brick_zyx, strict=True)]
            for z, y, x in product(*ranges) if samples.size else ():
                users[z, y, x].append(number)

        def fill(brick: Index) -> None:
            samples, (begin, end) = self.brick(brick), self.box_of(brick)
            for number in users[brick]:
                first, last = boxes[number]
                low, high = np.maximum(begin, first), np.minimum(end, last)
                read[number][_slices(low - first, high - first)] = samples[_slices(low - begin, high - begin)]

        # Bricks of a server are mostly waited for.
        for_each(fill, sorted(users), None if isinstance(self.path, Path) else CONNECTIONS)
        return read

    def brick(self, brick: Index) -> NDArray[Any]:
        """Return a decoded brick, of the full size, not to be written."""
        return CACHE.get(self._owner, (*self.index, *brick), lambda: self._decoded(brick))

    def _decoded(self, brick: Index) -> NDArray[Any]:
        data, where = self._stored(brick), f"{self.path}: brick {brick}"
        step = referred_step(data)
        if step is None:
            return self.codec.decode(data, self.brick_zyx, self.dtype, where)
        if not 0 <= step < self.step:
            raise DataError("a brick refers to a wrong time step", where=where, found=step)
        return self.at_step(step).brick(brick)

    def _stored(self, brick: Index) -> bytes:
        z, y, x = (i // n for i, n in zip(brick, self.shard_zyx, strict=True))
        path, where, key = self.shard_path((z, y, x)), f"{self.path}: brick {brick}", (*self.index, z, y, x)
        with self._lock:
            if key not in self._indices:
                self.check()
                self._indices[key] = self._read_index(path, where)
            index, version = self._indices[key]
        offset, count = (int(n) for n in index[self._slot(brick)])
        if (offset, count) == (_ABSENT, _ABSENT):
            raise DataError("a brick is missing", where=where)
        data, _ = read_range(path, offset, count, version)
        CACHE.count(len(data))
        if len(data) < max(count, _CRC_BYTES):
            raise DataError("a brick ends early", where=where, found=f"{len(data)} bytes", allowed=count)
        data, check = data[:-_CRC_BYTES], data[-_CRC_BYTES:]
        if checksum(data) != check:
            raise DataError("a brick has a wrong checksum: damaged, or written meanwhile", where=where)
        return data

    def _read_index(self, path: FilePath, where: str) -> tuple[NDArray[np.uint64], Version]:
        wanted = 16 * math.prod(self.shard_zyx) + _CRC_BYTES
        data, version = read_range(path, -wanted)
        size = version.size
        if len(data) < wanted or checksum(data[:-_CRC_BYTES]) != data[-_CRC_BYTES:]:
            raise DataError("the shard is damaged or truncated", where=where, found=f"{size} bytes")
        index = np.frombuffer(data[:-_CRC_BYTES], "<u8").reshape(-1, 2)
        present = index[index[:, 0] != _ABSENT].astype(np.float64)
        if size >= 0 and (present.sum(axis=1) > size).any():
            raise DataError("the shard is truncated, or its index damaged", where=where, found=f"{size} bytes")
        return index, version

    def _slot(self, brick: Index) -> int:
        _, ny, nx = self.shard_zyx
        z, y, x = (i % n for i, n in zip(brick, self.shard_zyx, strict=True))
        return (z * ny + y) * nx + x


def make_array(
    path: Path,
    shape_zyx: Index,
    brick: int,
    dtype: np.dtype[Any],
    codec: BrickCodec,
    axes: str = "",
    counts: tuple[int, ...] = (),
    index: tuple[int, ...] = (),
) -> ShardedArray:
    """Return the array of a level, with shards of up to `SHARD_BYTES`; nothing is written."""
    z, y, x = (min(brick, side) for side in shape_zyx)
    along = 1
    while 8 * along**3 * z * y * x * dtype.itemsize <= SHARD_BYTES:
        along *= 2
    nz, ny, nx = (min(along, count) for count in _quotients(shape_zyx, (z, y, x)))
    return ShardedArray(path, shape_zyx, (z, y, x), (nz, ny, nx), dtype, codec, axes, counts, index)


def open_array(
    path: FilePath, check: Callable[[], None] = lambda: None, has_checksums: bool = True
) -> ShardedArray | None:
    """Return the array in a folder, at its first time step and channel; None if its layout is not one read here."""
    found = read_json(path / "zarr.json")
    try:
        sharding = found["codecs"][0]["configuration"]
        first, *_ = codecs = sharding["codecs"]
        *counts, z, y, x = found["shape"]
        *_, bz, by, bx = sharding["chunk_shape"]
        nz, ny, nx = _quotients(found["chunk_grid"]["configuration"]["chunk_shape"][-3:], (bz, by, bx))
        axes, first_volume = "".join(found["dimension_names"][:-3]), (0,) * len(counts)
        if first["name"] == "clusterviz.wavelet":
            codec = BrickCodec("wavelet", **first["configuration"])
        elif first["name"] == zfp.NAME:
            codec = BrickCodec("zfp", first["configuration"].get("tolerance", 0.0))
        else:
            codec = BrickCodec("zstd", 0.0, codecs[1]["configuration"]["level"])
        sizes, dtype, folder = ((z, y, x), (bz, by, bx), (nz, ny, nx)), np.dtype(found["data_type"]), cast(Path, path)
        array = ShardedArray(folder, *sizes, dtype, codec, axes, tuple(counts), first_volume, check, has_checksums)
        is_possible = min(z, y, x, *counts, bz, by, bx) >= 1 and max(bz, by, bx) <= MOST_SIDE
        is_known = is_possible and array.metadata == found and axes in ("", "t", "c", "tc")
        return array if is_known and math.prod(array.counts_zyx) <= MOST_BRICKS else None
    except (KeyError, IndexError, TypeError, ValueError, ZeroDivisionError, InputError):
        return None


def array_metadata(
    shape: Iterable[int], chunk: Iterable[int], dtype: np.dtype[Any], codecs: list[dict[str, Any]], axes: list[str]
) -> dict[str, Any]:
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": list(shape),
        "data_type": dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(chunk)}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0.0 if dtype.kind == "f" else 0,
        "codecs": codecs,
        "dimension_names": axes,
        "attributes": {},
    }


def require_packages(where: str) -> None:
    for name in PACKAGES:
        library(name, "store", where)


def description_checksum(attributes: Mapping[str, Any]) -> str:
    """Return the checksum of what describes a store: OME's metadata, and those of clusterviz but for the checksum."""
    own = {key: value for key, value in attributes["clusterviz"].items() if key != "checksum"}
    return checksum(json.dumps([attributes.get("ome"), own], sort_keys=True).encode()).hex()


def read_json(path: FilePath) -> dict[str, Any]:
    with explained("damaged", path, ValueError):
        found = json.loads(read_range(path)[0])
    if not isinstance(found, dict):
        raise DataError("damaged", where=str(path), found=type(found).__name__, allowed="an object of JSON")
    return found


def write_json(path: Path, content: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2))


def checksum(data: bytes) -> bytes:
    """Return the CRC-32C of bytes, little-endian."""
    import google_crc32c  # which may be missing

    return int(google_crc32c.value(data)).to_bytes(_CRC_BYTES, "little")


def _quotients(sides: Iterable[int], parts: Index) -> Index:
    return as_index(-(-side // part) for side, part in zip(sides, parts, strict=True))


def _indices(counts: Index) -> list[Index]:
    return [(z, y, x) for z, y, x in product(*map(range, counts))]


def _slices(begin: Any, end: Any) -> tuple[slice, ...]:
    return tuple(slice(int(b), int(e)) for b, e in zip(begin, end, strict=True))
