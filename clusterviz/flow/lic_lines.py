"""Line integral convolution over ranks, where lines are handed from rank to rank.

Each rank holds the vectors of a box and of the few samples around it that one step needs, and convolves along the
parts of lines in its box. A line that leaves it is sent to the rank that holds the next cell, with its place, its sums
and the number of its next sample; at its end the sums go back to the rank of its voxel. The values have the same bits
as those of `LicSource`, which reads a halo as long as half a line around each block instead.

Halos are read and made once more for each block, the wider the longer lines are, and each rank reads vectors of others.
A line that is handed over takes about as long as 20 samples of a halo, and half as many lines as half a line is long
cross a sample of a face each way; `cheaper_way` compares both. Halos are cheaper on few ranks. Lines are on many ranks
with small boxes, each of which then holds the vectors of its box only.

References
----------
Pugmire, Childs, Garth, Ahern, Weber, Scalable computation of streamlines on very large datasets, SC 2009.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree, all_to_all
from clusterviz.comm.remote_memory import ThreadError
from clusterviz.content.flow.section import Lic
from clusterviz.data.bricks import Box
from clusterviz.data.source import Grid, Index
from clusterviz.data.vectors import VectorSource
from clusterviz.flow.domain import split_box
from clusterviz.flow.lic import (
    Field,
    LicSource,
    blocks_of,
    convolve_box,
    fastest,
    grown,
    halo_of,
    line_kernels,
    line_numbers,
    line_weights,
    noise_of,
    read_field,
    steps_of,
    stretched,
)
from clusterviz.jobs.array import DistributedArray, array_from

LINE = np.dtype([("voxel", "<i4", 3), ("next", "<i4"), ("state", "<f4", 5)])
"""Line on its way: its voxel (x, y, z), the number of its next sample, its displacement, sum and sum of weights."""
END = np.dtype([("voxel", "<i4", 3), ("way", "<i4"), ("sums", "<f4", 2)])
"""End of a line: its voxel (x, y, z), 0 downstream or 1 upstream, its sum and sum of weights."""
LINES_AT_ONCE = 1 << 20
HALO_SECONDS = 2e-7
"""To read the vector and make the noise of a sample in a halo, on one core."""
READ_SECONDS = 1.2e-8
"""To read a vector from a file system that all ranks share, at 1 GB/s."""
LINE_SECONDS = 4e-6
"""To hand over a line and its end, on one core."""
LINE_TAG, END_TAG = 30_021, 30_022


@dataclass
class Handed:
    """What one rank has sent and computed.

    Attributes
    ----------
    lines, ends : sent to other ranks
    rounds : exchanges between all ranks
    halo_voxels : samples around the box that were read
    """

    lines: int = 0
    ends: int = 0
    rounds: int = 0
    halo_voxels: int = 0

    @property
    def bytes_sent(self) -> int:
        return self.lines * LINE.itemsize + self.ends * END.itemsize


def seconds_of_ways(grid: Grid, lic: Lic, ranks: int) -> dict[str, float]:
    """Return about how long halos and lines that are handed over take beside the convolution: "halo" and "lines"."""
    halo, boxes = halo_of(lic, grid, steps_of(lic)), split_box(grid.shape_zyx, ranks)
    blocks = blocks_of(grid, lic, ranks)
    read = np.prod(
        [_samples_read(n, side, h) for n, side, h in zip(grid.shape_zyx, blocks.block_zyx, halo, strict=True)]
    )
    shared = lines = 0.0
    for begin, end in boxes:
        sides = np.subtract(end, begin)
        shared += float(np.prod(np.subtract(*grown(grid, begin, end, halo)[::-1])) - np.prod(sides))
        for axis in range(3):
            faces = (begin[axis] > 0) + (end[axis] < grid.shape_zyx[axis])
            lines += float(faces * np.prod(np.delete(sides, axis)) * halo[axis] / 2)
    around = float(read) - float(np.prod(grid.shape_zyx))
    return {"halo": around * HALO_SECONDS / ranks + shared * READ_SECONDS, "lines": lines * LINE_SECONDS / ranks}


def _samples_read(count: int, side: int, halo: int) -> int:
    """Return how many samples along an axis all blocks and their halos have."""
    return sum(min(count, b + side + halo) - max(0, b - halo) for b in range(0, count, side))


def cheaper_way(grid: Grid, lic: Lic, ranks: int) -> str:
    """Return which way is quicker: "halo" or "lines"."""
    seconds = seconds_of_ways(grid, lic, ranks)
    return min(seconds, key=lambda way: seconds[way])


class LicOverRanks:
    """Line integral convolution in the memory of all ranks, each of which has computed a part; see `Source`.

    Construction is collective.

    Parameters
    ----------
    channel : to all ranks
    vectors, lic : as of `LicSource`
    way : "halo", "lines", or "auto" for the cheaper one

    Attributes
    ----------
    way : that was taken
    bytes_sent : of lines that this rank handed over
    note : which way was taken, and why, in one line
    """

    dtype = np.dtype(np.float32)

    def __init__(self, channel: Channel, vectors: VectorSource, lic: Lic, way: str = "auto") -> None:
        self._alone, self.grid = LicSource(vectors, lic), vectors.grid
        self.name, self.bytes_sent = self._alone.name, 0
        self.way = cheaper_way(self.grid, lic, channel.size) if way == "auto" else way
        estimated = seconds_of_ways(self.grid, lic, channel.size)
        if self.way == "halo":
            shared = LicSource(vectors, lic, cache_bytes=0, ranks=channel.size)
            self._array = array_from(channel, shared, shared.blocks.block_zyx)
            text = f"halos of {max(halo_of(lic, self.grid, steps_of(lic)))} samples"
        else:
            box, values, handed = convolve_by_lines(channel, vectors, lic)
            self._array = DistributedArray(channel, self.grid.shape_zyx, np.float32, name=self.name)
            if values.size:
                self._array.write(box, values)
            self._array.sync()
            self.bytes_sent = handed.bytes_sent
            lines, ends = np.sum(channel.allgather((handed.lines, handed.ends)), axis=0).tolist()
            text = f"{lines} lines handed from rank to rank, {Handed(lines, ends).bytes_sent / 1e6:.3g} MB"
        self.note = f"{text} (estimated: halos {estimated['halo']:.2g} s, handing over {estimated['lines']:.2g} s)"

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[np.float32]:
        """Read a box from the ranks that hold it; see `Source.read`."""
        try:
            values: NDArray[np.float32] = self._array.read((begin_zyx, end_zyx))
        except ThreadError:  # Another node holds it, and this thread may not communicate: compute the same bits.
            return self._alone.read(begin_zyx, end_zyx)
        return values

    def free(self) -> None:
        """Release the memory; collective."""
        self._array.free()


def convolve_by_lines(channel: Channel, vectors: VectorSource, lic: Lic) -> tuple[Box, NDArray[np.float32], Handed]:
    """Convolve the box of each rank, and hand lines over; collective.

    Returns
    -------
    box : this rank's
    values : float32 (z, y, x) of its voxels
    handed : what this rank has sent
    """
    boxes = split_box(vectors.grid.shape_zyx, channel.size)
    with agree(channel, 0, "lic"):
        work = _Lines(vectors, lic, boxes, channel.rank)
    work.speed = max(channel.allgather(work.speed))
    with agree(channel, 0, "lic"):
        work.start()
    while channel.maximum(len(work.going) + len(work.ended)):
        lines, ends = work.taken()
        arrived = all_to_all(channel, lines, LINE_TAG), all_to_all(channel, ends, END_TAG)
        work.handed.rounds += 1
        with agree(channel, 0, "lic"):
            work.take_ends(np.concatenate(arrived[1]))
            work.follow(np.concatenate(arrived[0]))
    return boxes[channel.rank], work.values(), work.handed


@dataclass
class _Lines:
    """Lines of one rank's voxels, and those that are in its box."""

    vectors: VectorSource
    lic: Lic
    boxes: list[Box]
    rank: int
    handed: Handed = field(default_factory=Handed)
    speed: float = 0.0

    def __post_init__(self) -> None:
        (self.begin, self.end), grid = self.boxes[self.rank], self.vectors.grid
        self.shape = np.subtract(self.end, self.begin)
        self.going, self.ended = np.empty(0, LINE), np.empty(0, END)
        self.weights = line_weights(self.lic.kernel, self.lic.length, self.lic.step)
        self.steps = len(self.weights) // 2
        self.sums = np.zeros((2, 2, *self.shape), np.float32)
        self.field: Field | None = None
        if self.shape.all():
            # A line may be at the far side of its cell when it steps into the next one.
            z, y, x = (n + 1 for n in halo_of(self.lic, grid, min(1, self.steps)))
            first, last = grown(grid, self.begin, self.end, (z, y, x))
            self.field = read_field(self.vectors, noise_of(self.lic), first, last)
            self.handed.halo_voxels = self.field.values.size // 4 - int(np.prod(self.shape))
            if self.lic.by_speed:
                self.speed = fastest(self.vectors, self.begin, self.end)

    def start(self) -> None:
        """Convolve voxels whose lines stay in the box, and begin the lines of the others."""
        if self.field is None:
            return
        grid, lic = self.vectors.grid, self.lic
        halo = halo_of(lic, grid, self.steps)
        low = [b + h * (b > 0) for b, h in zip(self.begin, halo, strict=True)]
        high = [e - h * (e < n) for e, h, n in zip(self.end, halo, grid.shape_zyx, strict=True)]
        self.inner: Box = tuple(low), tuple(max(a, b) for a, b in zip(low, high, strict=True))  # type: ignore[assignment]
        outer = np.ones(self.shape, bool)
        outer[tuple(slice(a - b, e - b) for a, e, b in zip(*self.inner, self.begin, strict=True))] = False
        voxels = (np.argwhere(outer) + self.begin)[:, ::-1]
        for begin in range(0, len(voxels), LINES_AT_ONCE):
            part = voxels[begin : begin + LINES_AT_ONCE]
            for way in (1, -1):
                lines = np.zeros(len(part), LINE)
                lines["voxel"], lines["next"] = part, way if self.steps else 0
                self.follow(lines)

    def follow(self, lines: NDArray[Any]) -> None:
        """Follow lines as far as the box goes; keep what other ranks get."""
        if not len(lines) or self.field is None:
            return
        grid, origin = self.vectors.grid, np.array(self.field.begin_zyx[::-1], np.int32)
        numbers = np.concatenate([lines["voxel"] - origin, lines["next"][:, None]], axis=1)
        state, ways = np.ascontiguousarray(lines["state"]), lines["next"] < 0
        own = [tuple((np.array(place[::-1]) - origin).tolist()) for place in (self.begin, self.end)]
        _KERNELS[self.lic.integrator][len(lines)](
            self.field.values, self.weights, numbers, state, *own, *line_numbers(self.field, grid, self.lic, self.speed)
        )
        done = numbers[:, 3] == 0
        ends = np.empty(np.count_nonzero(done), END)
        ends["voxel"], ends["way"], ends["sums"] = lines["voxel"][done], ways[done], state[done, 3:]
        home = self._owners(ends["voxel"]) == self.rank
        self.take_ends(ends[home])
        self.ended = np.concatenate([self.ended, ends[~home]])
        going = lines[~done].copy()
        going["next"], going["state"] = numbers[~done, 3], state[~done]
        self.going = np.concatenate([self.going, going])

    def taken(self) -> tuple[list[NDArray[Any]], list[NDArray[Any]]]:
        """Return the lines and the ends for each rank, which this one forgets."""
        last = np.array(self.vectors.grid.shape_zyx[::-1]) - 1
        cells = np.floor(self.going["state"][:, :3].astype(np.float64)).astype(np.int64) + self.going["voxel"]
        lines = self._by_rank(self.going, self._owners(np.clip(cells, 0, np.maximum(last - 1, 0))))
        ends = self._by_rank(self.ended, self._owners(self.ended["voxel"]))
        self.handed.lines, self.handed.ends = self.handed.lines + len(self.going), self.handed.ends + len(self.ended)
        self.going, self.ended = self.going[:0], self.ended[:0]
        return lines, ends

    def take_ends(self, ends: NDArray[Any]) -> None:
        """Keep the sums of own lines."""
        x, y, z = (ends["voxel"] - np.array(self.begin[::-1])).T
        self.sums[ends["way"], :, z, y, x] = ends["sums"]

    def values(self) -> NDArray[np.float32]:
        """Return the values of the box, in the order of sums of lic.glsl."""
        if self.field is None:
            return np.empty(self.shape, np.float32)
        own = tuple(slice(b - f, e - f) for b, e, f in zip(self.begin, self.end, self.field.begin_zyx, strict=True))
        start = self.field.values[own]
        weight = self.weights[self.steps]
        found = weight * start[..., 3] + self.sums[0, 0] + self.sums[1, 0]
        found /= weight + self.sums[0, 1] + self.sums[1, 1]
        found[np.isnan(start[..., :3]).any(axis=-1)] = np.nan
        begin, end = self.inner
        if np.subtract(end, begin).all():
            inner = tuple(slice(b - f, e - f) for b, e, f in zip(begin, end, self.begin, strict=True))
            found[inner] = convolve_box(self.field, self.vectors.grid, self.lic, begin, end, self.speed)
        return stretched(found, self.lic)

    def _owners(self, voxels: NDArray[Any]) -> NDArray[np.int32]:
        """Return the ranks whose boxes hold voxels (n, 3), x, y, z."""
        found = np.full(len(voxels), -1, np.int32)
        for rank, (begin, end) in enumerate(self.boxes):
            found[((voxels >= begin[::-1]) & (voxels < end[::-1])).all(axis=1)] = rank
        return found

    def _by_rank(self, records: NDArray[Any], owners: NDArray[np.int32]) -> list[NDArray[Any]]:
        return [np.ascontiguousarray(records[owners == rank]) for rank in range(len(self.boxes))]


def _lic_lines(  # type: ignore[no-untyped-def]
    field, weights, lines, state, own_begin, own_end,
    first_voxel, last_voxel, samples_per_length, step_length, steps, by_speed, tolerance,
):  # fmt: skip
    """Sums of the noise along parts of lines."""


_KERNELS = line_kernels(_lic_lines, "lic_lines.glsl", ("lines", "state"))
