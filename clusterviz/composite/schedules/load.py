"""Load of a schedule: messages and pixels that each rank sends and receives, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clusterviz.composite.schedules.schedule import Indices, Schedule


@dataclass(frozen=True, eq=False)
class Load:
    """Load of each rank, by position in visibility order, without the final gather.

    Attributes
    ----------
    rounds : number of stages with transfers
    messages_sent, messages_received, pixels_sent, pixels_received : int64 (ranks,)
    """

    rounds: int
    messages_sent: Indices
    messages_received: Indices
    pixels_sent: Indices
    pixels_received: Indices


def count_dense(schedule: Schedule) -> Load:
    """Return the load for dense images, by counting the transfers."""
    sizes = [len(stage) for stage in schedule.stages]
    table = np.concatenate([np.empty((0, 4), np.int64), *(stage.table for stage in schedule.stages)])
    stage = np.repeat(np.arange(len(sizes), dtype=np.int64), sizes)
    return count_transfers(schedule.ranks, stage, table[:, 0], table[:, 1], table[:, 3] - table[:, 2])


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
