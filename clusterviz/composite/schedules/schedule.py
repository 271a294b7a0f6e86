"""Schedules: the transfers of a compositing algorithm as data.

Ranks are positions in visibility order, 0 in front; pixels are numbered along one line. A schedule does not depend on
screens, colours or channels, so it can be printed, drawn, checked, counted, or run over any channel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.fragment import Patch

Indices = NDArray[np.int64]


def borders(pieces: int, pixels: int) -> Indices:
    """Return the beginnings of all pieces, and the end of the last, int64 (pieces + 1,); exact for any int64."""
    index, (whole, rest) = np.arange(pieces + 1, dtype=np.int64), divmod(pixels, max(pieces, 1))
    return index * whole + index * rest // max(pieces, 1)


@dataclass(frozen=True)
class Transfer:
    """Transfer of all pixels in [begin, end) that rank `source` holds to rank `target`; the source keeps none."""

    source: int
    target: int
    begin: int
    end: int


@dataclass(frozen=True, eq=False)
class Stage:
    """Concurrent transfers; pixels that are received in a stage are sent on in a later one.

    `table`: int64 (transfers, 4), read-only: columns source, target, begin, end.
    """

    table: Indices

    @staticmethod
    def of_columns(source: Indices, target: Indices, begin: Indices, end: Indices) -> Stage:
        """Return a stage of transfers given as columns; empty ones, and those of a rank to itself, are left out."""
        table = np.empty((*np.broadcast(source, target, begin, end).shape, 4), np.int64)
        for column, values in enumerate((source, target, begin, end)):
            table[..., column] = values
        return Stage.of_table(table[(table[..., 0] != table[..., 1]) & (table[..., 3] > table[..., 2])])

    @staticmethod
    def of_table(table: Indices) -> Stage:
        """Return a stage of transfers given as rows, none empty or of a rank to itself; takes over the table."""
        table.setflags(write=False)
        return Stage(table)

    @staticmethod
    def join(stages: Sequence[Stage]) -> Stage:
        """Return one stage with the transfers of several."""
        return Stage.of_table(np.concatenate([np.empty((0, 4), np.int64), *(stage.table for stage in stages)]))

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[Transfer]:
        return (Transfer(*row) for row in self.table.tolist())

    def sent_by(self, rank: int) -> list[Transfer]:
        """Return the transfers with this source."""
        return self._rows(0, self._by_source, rank)

    def received_by(self, rank: int) -> list[Transfer]:
        """Return the transfers with this target."""
        return self._rows(1, self._by_target, rank)

    @cached_property
    def _by_source(self) -> Indices:
        return _order(self.table[:, 0])

    @cached_property
    def _by_target(self) -> Indices:
        return _order(self.table[:, 1])

    def _rows(self, column: int, order: Indices, rank: int) -> list[Transfer]:
        keys = self.table[:, column]
        begin = np.searchsorted(keys, rank, "left", sorter=order)
        end = np.searchsorted(keys, rank, "right", sorter=order)
        return [Transfer(*row) for row in self.table[order[begin:end]].tolist()]


def _order(ranks: Indices) -> Indices:
    """Return the indices that sort the rows by rank; 16-bit numbers are sorted in linear time."""
    few = int(ranks.max(initial=0)) <= np.iinfo(np.uint16).max
    return np.argsort(ranks.astype(np.uint16) if few else ranks, kind="stable")


@dataclass(frozen=True, eq=False)
class Load:
    """Load of each rank, by position in visibility order, without the final gather."""

    rounds: int  # number of stages with transfers
    # int64 (ranks,)
    messages_sent: Indices
    messages_received: Indices
    pixels_sent: Indices
    pixels_received: Indices

    @property
    def messages(self) -> int:
        return int(self.messages_sent.sum())

    @property
    def pixels(self) -> int:
        """Pixels that all ranks send."""
        return int(self.pixels_sent.sum())

    @property
    def most_messages(self) -> int:
        """Messages sent or received by the busiest rank."""
        return int(max(self.messages_sent.max(initial=0), self.messages_received.max(initial=0)))

    @property
    def most_pixels(self) -> int:
        """Pixels sent or received by the busiest rank."""
        return int(max(self.pixels_sent.max(initial=0), self.pixels_received.max(initial=0)))


@dataclass(frozen=True, eq=False)
class Schedule:
    """All stages of compositing `ranks` images of `pixels` pixels."""

    ranks: int
    pixels: int
    stages: tuple[Stage, ...]

    def counts(self) -> Load:
        """Return the load for dense images; transfers between two ranks within one stage are one message."""
        table = Stage.join(self.stages).table
        stage = np.repeat(np.arange(len(self.stages), dtype=np.int64), [len(stage) for stage in self.stages])
        return count_transfers(self.ranks, stage, table[:, 0], table[:, 1], table[:, 3] - table[:, 2])


Patches = Sequence[Patch]
# Schedule function of ranks, pixels, and the patch of each rank's image (none: the whole canvas) by position.
Algorithm = Callable[[int, int, Patches], Schedule]


class MultiImageAlgorithm(Protocol):
    """Algorithm with SEVERAL_IMAGES = True in its module: ranks may have several images, in any order of depth.

    There is one footprint for each image, and `owners_of` is the position of its rank; None: position k has image k.
    Transfers are between ranks: a rank sends the range of all its images at once.
    """

    def __call__(
        self, ranks: int, pixels: int, footprints: Patches = ..., *, owners_of: Sequence[int] | None = None
    ) -> Schedule: ...


def check(schedule: Schedule) -> None:
    """Check a schedule by following which images of which pixels each rank holds.

    Raises ValueError for a message of a rank to itself or of no pixels; a pixel sent that is not held, or sent twice;
    images merged that are not neighbours in visibility order; at the end, a pixel that is not on exactly one rank with
    all images merged.
    """
    ranks = schedule.ranks
    tables = [stage.table for stage in schedule.stages]
    borders = np.unique(np.concatenate([[0, schedule.pixels], *(table[:, 2:].ravel() for table in tables)]))
    # Each rank holds images [low, high) of each cell between two borders; none where they are equal.
    low = np.repeat(np.arange(ranks, dtype=np.int64)[:, None], len(borders) - 1, axis=1)
    high = low + 1
    for number, table in enumerate(tables):
        low, high = _check_stage(number, table, borders, low, high)
    held = high - low
    if schedule.pixels and not (np.all((held == 0) | (held == ranks)) and np.all((held == ranks).sum(axis=0) == 1)):
        raise ValueError("a pixel does not end on exactly one rank with all images merged")


def _check_stage(number: int, table: Indices, borders: Indices, low: Indices, high: Indices) -> tuple[Indices, Indices]:
    """Return which images of each cell each rank holds after a stage."""
    kept = high - low
    nothing = (table[:, 0] == table[:, 1]) | (table[:, 2] >= table[:, 3])
    _refuse(number, table[nothing], "a message to oneself or of no pixels")
    # One entry for each cell of each transfer: index of the transfer, and of the cell on its source and its target.
    cells = len(borders) - 1
    first, end = np.searchsorted(borders, table[:, 2:]).T
    which = np.repeat(np.arange(len(table)), end - first)
    cell = np.arange(len(which)) + np.repeat(end - np.cumsum(end - first), end - first)
    source, target = table[which, 0] * cells + cell, table[which, 1] * cells + cell
    wrong = kept.reshape(-1)[source] <= 0
    again = np.ones(len(which), bool)
    again[np.unique(source, return_index=True)[1]] = False
    _refuse(number, table[which[wrong | again]], "pixels that the source does not hold, or sends twice")
    # A source drops what it sends before it merges what it receives.
    total = kept.reshape(-1).copy()
    total[source] = 0
    merged_low = np.where(total > 0, low.reshape(-1), np.iinfo(np.int64).max)
    merged_high = np.where(total > 0, high.reshape(-1), -1)
    np.minimum.at(merged_low, target, low.reshape(-1)[source])
    np.maximum.at(merged_high, target, high.reshape(-1)[source])
    np.add.at(total, target, kept.reshape(-1)[source])
    if np.any((total > 0) & (merged_high - merged_low != total)):
        raise ValueError(f"stage {number}: images are merged that are not neighbours in visibility order")
    merged_low[total == 0] = merged_high[total == 0] = 0
    return merged_low.reshape(low.shape), merged_high.reshape(low.shape)


def _refuse(number: int, transfers: Indices, why: str) -> None:
    for source, target, begin, end in transfers[:1].tolist():
        raise ValueError(f"stage {number}, {source} to {target}, pixels [{begin}, {end}): {why}")


def count_transfers(ranks: int, stage: Indices, source: Indices, target: Indices, pixels: Indices) -> Load:
    """Return the load of transfers given as columns; those of one stage between the same two ranks are one message."""
    there = pixels > 0
    stage, source, target, pixels = stage[there], source[there], target[there], pixels[there]
    pairs = np.unique((stage * ranks + source) * ranks + target)
    return Load(
        len(np.unique(stage)),
        sum_by(ranks, pairs // max(ranks, 1) % max(ranks, 1)),
        sum_by(ranks, pairs % max(ranks, 1)),
        sum_by(ranks, source, pixels),
        sum_by(ranks, target, pixels),
    )


def sum_by(ranks: int, rank: Indices, values: Indices | int = 1) -> Indices:
    """Return the exact integer sum of the values of each rank."""
    result = np.zeros(ranks, np.int64)
    np.add.at(result, rank, values)
    return result
