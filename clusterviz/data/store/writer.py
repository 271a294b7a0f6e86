"""Writing of a store: OME-Zarr 0.5 with levels, from any volume, in bounded memory, by any number of processes.

    OUT.ome.zarr/zarr.json        OME's metadata, and `clusterviz`: what the store was made of, whether it is whole, and
                                  the checksum of all these
    OUT.ome.zarr/0, 1, …          levels, the finest first; bricks in shards
    OUT.ome.zarr/bricks/0, 1, …   float64 (3, z, y, x bricks): minimum, maximum, and largest error of each brick
    OUT.ome.zarr/bricks/statistics.npz   summary of the finest level: see `levels.py`; statistics-T-C.npz of
                                  time step T and channel C

Each process writes whole files, which appear when they are complete, so a run that was stopped is continued by the same
command. Level by level, all shards are written, then read again to measure them, which verifies them. What the store
holds does not depend on the number of processes. Minimum and maximum are of the samples of a brick that can be read,
+inf and −inf if none is finite. The error is a bound of the difference between the source and the samples of a brick;
on coarser levels also of those interpolated between it and the next bricks.

Time steps and channels are axes before z, in `bricks` too, and each is written like a volume of its own. With wavelets
a brick that is no farther than the error from the decoded one of the time step before is a reference: all its bytes are
the number of the first step with these samples. So errors do not add up. For each brick of a time step `bricks` also
holds this number, with every codec.
"""

from __future__ import annotations

import fcntl
import math
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import Box, BrickLayout, with_margin
from clusterviz.data.series import Series
from clusterviz.data.source import Grid, Index, Source, as_index
from clusterviz.data.store.levels import (
    MARGIN,
    Read,
    coarser,
    difference,
    is_within,
    largest_difference,
    low_pass,
    read_statistics,
    write_statistics,
)
from clusterviz.data.store.shards import (
    BrickCodec,
    ShardedArray,
    description_checksum,
    make_array,
    read_json,
    require_packages,
    write_json,
)
from clusterviz.data.store.wavelet import encode_reference
from clusterviz.data.summary import AllGather, summarise, summary_over_time
from clusterviz.errors import DataError, OutputError
from clusterviz.image.replace import folder_error

VERSION = 2
"""Of what stores hold; those of version 1 have no checksums but those of samples."""
COLOURS = ("00FF00", "FF00FF", "00FFFF", "FFFF00", "FF0000", "0000FF", "FFFFFF")
"""Colours of channels in turn, red, green and blue in hexadecimal digits."""
Report = Callable[[float], None]
"""Called with the share of a step that is done."""


@dataclass(frozen=True)
class StoreWriter:
    """A store and a volume from which it is made; methods are called on every process in the order given here.

    Attributes
    ----------
    rank, size : of this process, and their number; files are shared evenly
    series : time steps and channels of which the volume is one; None: it is the only one
    index : of the volume among them; those of earlier time steps must be complete
    """

    source: Source
    path: Path
    codec: BrickCodec
    brick: int = 64
    rank: int = 0
    size: int = 1
    series: Series | None = None
    index: tuple[int, ...] = ()

    @cached_property
    def arrays(self) -> tuple[ShardedArray, ...]:
        """The levels, the finest first; the last one is one brick."""
        shape, found = self.source.grid.shape_zyx, list[ShardedArray]()
        several = (self.series.axes, self.series.counts, self.index) if self.series else ()
        while not found or max(found[-1].counts_zyx) > 1:
            path = self.path / str(len(found))
            found.append(make_array(path, shape, self.brick, self.source.dtype, self.codec, *several))
            shape = coarser(shape)
        return tuple(found)

    def begin(self) -> int:
        """Lock the store and write the metadata, or check those of one that is continued; return the lock's handle.

        Raises
        ------
        InputError
            The codec does not pack the type of the samples.
        OutputError
            Something else is there, another process writes it, or it cannot be written.
        """
        self.codec.check(self.source.dtype)
        try:
            self.path.mkdir(exist_ok=True)
            handle = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        except FileExistsError as error:
            raise OutputError("a file is in the way", where=str(self.path), allowed="a new name") from error
        except OSError as error:
            raise folder_error(self.path, error) from error
        try:
            with suppress(OSError):  # a file system without locks
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError as error:
                    raise OutputError("another process writes this store", where=str(self.path)) from error
            complete = any(self.path.iterdir()) and self._check_same()
            group = {"zarr_format": 3, "node_type": "group", "attributes": {}}
            if not complete:
                write_json(self.path / "zarr.json", group | {"attributes": self._attributes(False)})
            write_json(self.path / "bricks" / "zarr.json", group)
            for array in self.arrays:
                write_json(array.path / "zarr.json", array.metadata)
                write_json(self.path / "bricks" / array.path.name / "zarr.json", array.statistics_metadata)
        except BaseException:
            os.close(handle)
            raise
        return handle

    def write(self, level: int, report: Report = lambda done: None) -> None:
        """Write this process's shards of a level; the finer ones must be complete."""
        array, read = self.arrays[level], self.source.read if level == 0 else self._read_finer(level)
        mine = array.shards[self.rank :: self.size]
        for n, shard in enumerate(mine):
            if not (array.shard_path(shard).exists() and (level or array.statistics_path(shard).exists())):
                array.write_shard(shard, self._encoded(array, shard, read, level))
            report((n + 1) / len(mine))

    def measure(self, level: int, report: Report = lambda done: None) -> None:
        """Write the statistics of this process's shards of a coarser level, which must be complete."""
        array = self.arrays[level]
        mine = array.shards[self.rank :: self.size] if level else []
        errors = self.arrays[level - 1].statistics()[2] if mine else np.empty(0)
        for n, shard in enumerate(mine):
            if not array.statistics_path(shard).exists():
                before = _Before(array)
                found = {brick: self._measured(level, brick, errors, before) for brick in array.bricks_of(shard)}
                array.write_statistics(shard, found)
            report((n + 1) / len(mine))

    def summarise(self, allgather: AllGather, report: Report = lambda done: None) -> None:
        """Write the summary of the finest level as it is read, which must be complete; collective."""
        array = self.arrays[0]
        if any(allgather(array.summary_path.exists())):
            return
        layout = BrickLayout(array.shape_zyx, self.brick, MARGIN)
        mine = array.shards[self.rank :: self.size]

        def read() -> Iterator[tuple[Index, NDArray[Any]]]:
            for n, shard in enumerate(mine):
                report(n / len(mine))
                # A last brick of one sample along an axis is a corner of the cells before it.
                bricks = [brick for brick in array.bricks_of(shard) if np.less(brick, layout.counts_zyx).all()]
                boxes = [layout.sample_box(brick) for brick in bricks]
                for brick, samples in zip(bricks, array.read_boxes(boxes), strict=True):
                    yield brick, with_margin(layout, brick, samples)

        summary = summarise(array.dtype, layout, read, allgather)
        if self.rank == 0:
            write_statistics(array.summary_path, summary, layout)

    def finish(self) -> None:
        """Mark the store as complete; on one process, after all have written."""
        content, attributes = read_json(self.path / "zarr.json"), self._attributes(True)
        if self.series and self.series.channels:
            attributes["ome"]["omero"] = {"channels": [self._channel(n) for n in range(len(self.series.channels))]}
        attributes["clusterviz"]["checksum"] = description_checksum(attributes)
        write_json(self.path / "zarr.json", content | {"attributes": attributes})

    def _channel(self, number: int) -> dict[str, Any]:
        """Return OME's description of a channel, with the range of its samples in the finest level."""
        assert self.series is not None, "there are channels"
        arrays = [self.arrays[0].at(*index) for index in self.series.indices if index[-1] == number]
        layout = BrickLayout(arrays[0].shape_zyx, self.brick, MARGIN)
        found = summary_over_time([read_statistics(array.summary_path, layout) for array in arrays])
        given = self.series.omero[number] if self.series.omero else None
        start, end = given.window if given and given.window else (found.percentile(1.0), found.percentile(99.0))
        colour = COLOURS[number % len(COLOURS)]
        if given and given.color:
            colour = "".join(f"{round(255 * value):02X}" for value in given.color)
        window = {"min": found.value_range[0], "max": found.value_range[1], "start": start, "end": end}
        active = given is None or given.active
        return {"label": self.series.channels[number], "color": colour, "window": window, "active": active}

    def _encoded(self, array: ShardedArray, shard: Index, read: Read, level: int) -> Iterator[tuple[Index, bytes]]:
        """Yield the bricks of a shard, read in layers along z; of the finest level, then write its statistics."""
        bricks, found = array.bricks_of(shard), dict[Index, tuple[float, ...]]()
        before = _Before(array)
        for z in sorted({brick[0] for brick in bricks}):
            layer = [brick for brick in bricks if brick[0] == z]
            begin, end = array.box_of(layer[0])[0], array.box_of(layer[-1])[1]
            samples = read(begin, end)
            for brick in layer:
                own = samples[_within(array.box_of(brick), begin)]
                near = before.within(brick, own, self.codec.error) if self.codec.name == "wavelet" else None
                data = array.encode(own) if near is None else encode_reference(before.steps[brick])
                yield brick, data
                if level == 0:
                    stored = near if near is not None else self._stored(array, data, own)
                    found[brick] = *extremes(stored), largest_difference(own, stored), before.step_of(brick, stored)
        if level == 0:
            array.write_statistics(shard, found)

    def _stored(self, array: ShardedArray, data: bytes, samples: NDArray[Any]) -> NDArray[Any]:
        if self.codec.error == 0:
            return samples
        z, y, x = samples.shape
        return self.codec.decode(data, array.brick_zyx, array.dtype, str(array.path))[:z, :y, :x]

    def _read_finer(self, level: int) -> Read:
        finer = self.arrays[level - 1]
        return lambda begin, end: low_pass(finer.read, finer.shape_zyx, begin, end)

    def _measured(self, level: int, brick: Index, errors: NDArray[np.float64], before: _Before) -> tuple[float, ...]:
        """Return the statistics of a brick of a coarser level, the error by those of the bricks below."""
        finer, array = self.arrays[level - 1], self.arrays[level]
        begin, end = array.box_of(brick)
        coarse = array.read(begin, _clipped([e + 1 for e in end], array.shape_zyx))
        low = _clipped([2 * b for b in begin], finer.shape_zyx)
        high = _clipped(
            [n if e == a else 2 * e + 1 for e, a, n in zip(end, array.shape_zyx, finer.shape_zyx, strict=True)],
            finer.shape_zyx,
        )
        away = difference(finer.read(low, high), coarse)
        below = errors[
            tuple(slice(b // side, -(-e // side)) for b, e, side in zip(low, high, finer.brick_zyx, strict=True))
        ]
        z, y, x = np.subtract(end, begin)
        own = coarse[:z, :y, :x]
        return *extremes(own), float(below.max()) + away, before.step_of(brick, own)

    def _check_same(self) -> bool:
        """Check that a store which is there was begun by the same command; return whether it is complete."""
        try:
            found = read_json(self.path / "zarr.json")["attributes"]["clusterviz"]
        except (DataError, KeyError, TypeError):
            found = {}
        wanted = self._attributes(False)["clusterviz"]
        other = [key for key, value in wanted.items() if key != "complete" and found.get(key) != value]
        if other:
            differs = ", ".join(other) if found else "no store of clusterviz"
            raise OutputError("something else is there", where=str(self.path), found=differs, allowed="a new name")
        return bool(found["complete"])

    def _attributes(self, complete: bool) -> dict[str, Any]:
        grid, sources = self.source.grid, self.series.sources if self.series else ()
        own = {
            "version": VERSION,
            "complete": complete,
            "source": [_identity(each.name) for each in sources] if self.series else _identity(self.source.name),
            "codec": {"name": self.codec.name, "error": self.codec.error, "effort": self.codec.effort},
            "brick": self.brick,
            "shape": list(grid.shape_zyx),
            "volumes": list(self.series.counts) if self.series else [],
            "dtype": self.source.dtype.name,
            "direction": [list(row) for row in grid.direction],
            "orientation": grid.orientation,
            "modality": grid.modality,
        }
        ome = ome_metadata(grid, len(self.arrays), Path(self.path).name.split(".")[0], self.series)
        return {"ome": ome, "clusterviz": own}


@dataclass(frozen=True)
class _Before:
    """A level at the time step before; there may be none."""

    array: ShardedArray

    @cached_property
    def _level(self) -> ShardedArray | None:
        return self.array.at_step(self.array.step - 1) if self.array.step else None

    @cached_property
    def steps(self) -> NDArray[np.int64]:
        """Steps from which on the samples of the bricks are the same, as `ShardedArray.steps`."""
        assert self._level is not None, "there is a step before"
        return self._level.steps()

    def within(self, brick: Index, samples: NDArray[Any], error: float) -> NDArray[Any] | None:
        """Return the decoded samples of the step before if none is farther than an error from the given ones."""
        if self._level is None:
            return None
        z, y, x = samples.shape
        found = self._level.brick(brick)[:z, :y, :x]
        return found if is_within(samples, found, error) else None

    def step_of(self, brick: Index, stored: NDArray[Any]) -> int:
        same = self.within(brick, stored, 0.0) is not None
        return int(self.steps[brick]) if same else self.array.step


def write_store(
    source: Source | Series,
    path: Path,
    codec: BrickCodec,
    brick: int = 64,
    rank: int = 0,
    size: int = 1,
    together: Callable[[str], AbstractContextManager[None]] = lambda stage: nullcontext(),
    allgather: AllGather = lambda value: [value],
    report: Callable[[str, float], None] = lambda step, done: None,
) -> StoreWriter:
    """Write a volume, or time steps and channels, as a store, or continue with one; collective.

    Parameters
    ----------
    source, path, codec, brick, rank, size : as of `StoreWriter`
    together : context in which all processes do a stage, and at whose end they wait for each other; in the stage
        "statistics" they exchange values
    allgather : shares one picklable value with all processes, and returns those of all
    report : called with the name of a step and the share of it that is done

    Raises
    ------
    DataError
        The source cannot be read, or a package is not installed.
    OutputError
        The store cannot be written, or is another one.
    """
    require_packages(str(path))
    series = source if isinstance(source, Series) else Series((source,))
    several = series if series.axes else None
    first = StoreWriter(series.sources[0], path, codec, brick, rank, size, several, series.indices[0])
    handle = -1
    try:
        with together("metadata"):
            if rank == 0:
                handle = first.begin()
        for each, index, label in zip(series.sources, series.indices, series.labels, strict=True):
            writer = replace(first, source=each, index=index)  # another cache
            for level in range(len(first.arrays)):
                with together(f"{label}level {level}"):
                    writer.write(level, partial(report, f"{label}level {level}"))
                with together(f"{label}error {level}"):
                    writer.measure(level, partial(report, f"{label}level {level}"))
            with together("statistics"):
                writer.summarise(allgather, partial(report, f"{label}statistics"))
        with together("metadata"):
            if rank == 0:
                first.finish()
    finally:
        if handle >= 0:
            os.close(handle)
    return first


def ome_metadata(grid: Grid, levels: int, name: str, series: Series | None = None) -> dict[str, Any]:
    """Return OME-Zarr's description of a volume and its levels; rotations are not part of it."""
    before = series.axes if series else ""

    def dataset(level: int) -> dict[str, Any]:
        scale = [step * 2.0**level for step in reversed(grid.spacing)]
        transforms = [
            {"type": "scale", "scale": [1.0] * len(before) + scale},
            {"type": "translation", "translation": [0.0] * len(before) + [*reversed(grid.origin)]},
        ]
        return {"path": str(level), "coordinateTransformations": transforms}

    kinds = {"t": "time", "c": "channel"}
    scales = {
        "name": name,
        "axes": [{"name": axis, "type": kinds.get(axis, "space")} for axis in f"{before}zyx"],
        "datasets": [dataset(level) for level in range(levels)],
        "type": "linear spline",
    }
    return {"version": "0.5", "multiscales": [scales]}


def extremes(samples: NDArray[Any]) -> tuple[float, float]:
    """Return the smallest and the largest finite sample; +inf and −inf without one."""
    low, high = samples.min(), samples.max()
    if not (np.isfinite(low) and np.isfinite(high)):
        finite = samples[np.isfinite(samples)]
        return (float(finite.min()), float(finite.max())) if finite.size else (math.inf, -math.inf)
    return float(low), float(high)


def _within(box: Box, begin: Index) -> tuple[slice, ...]:
    return tuple(slice(b - at, e - at) for b, e, at in zip(*box, begin, strict=True))


def _clipped(position: list[int], shape: Index) -> Index:
    return as_index(min(p, n) for p, n in zip(position, shape, strict=True))


def _identity(name: str) -> list[Any]:
    """Return what tells a source from another one: its name, and size and time of its file, if it is one."""
    try:
        status = os.stat(name)
    except OSError:
        return [name]
    return [name, status.st_size, status.st_mtime_ns]
