"""Schedules: which rank runs which block of a job, as pure functions; see `cluster.py` for what runs them.

A schedule is a list of queues of blocks. A rank takes from the front of its own queue; where it is empty, and blocks
may be stolen, from the back of the others'. A queue is one counter, of what was taken from its front and from its back:
an access to it is a single one-sided addition.

shared   one queue of all blocks, in order, for all ranks
random   one queue in a random order, to compare with
static   one queue a rank with equal parts; nothing is stolen
local    one queue a rank, with the blocks of whose declared reads the rank holds most [1]_; blocks of a slow rank are
         stolen

References
----------
.. [1] Thesis, section 6.2.4, job scheduling: the share d_n(j) of what block j reads that lies in the memory of rank n.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from typing import Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError

ScheduleName = Literal["local", "shared", "static", "random"]
SCHEDULES: tuple[str, ...] = get_args(ScheduleName)
Node = TypeVar("Node", bound=Hashable)

BACK_BITS = 36
"""Bits of a counter for what was taken from the front; those above are for the back."""


@dataclass(frozen=True)
class Schedule:
    """Queues of blocks.

    Attributes
    ----------
    queues : numbers of blocks, each in one queue; one for all ranks or one a rank
    steals : whether ranks take blocks of other queues when theirs is empty
    """

    queues: tuple[tuple[int, ...], ...]
    steals: bool = False

    def own(self, rank: int) -> int:
        """Return the number of a rank's own queue."""
        return rank % len(self.queues)


def make_schedule(
    name: ScheduleName, blocks: int, ranks: int, held: NDArray[np.int64] | None = None, seed: int = 0
) -> Schedule:
    """Return the schedule of a name.

    Parameters
    ----------
    held : int64 (blocks, ranks), bytes that a block reads and a rank holds, for "local"
    seed : of "random"

    Raises
    ------
    InputError
        There is no such schedule.
    """
    match name:
        case "shared":
            return Schedule((tuple(range(blocks)),))
        case "random":
            return Schedule((tuple(np.random.default_rng(seed).permutation(blocks).tolist()),))
        case "static":
            return Schedule(_equal_parts(blocks, ranks))
        case "local":
            if held is None or not held.any():
                return Schedule(_equal_parts(blocks, ranks), steals=True)
            return Schedule(_local_queues(held), steals=True)
    raise InputError("no such schedule", found=name, allowed=", ".join(SCHEDULES))


def in_order(schedule: Schedule, order: Sequence[int]) -> Schedule:
    """Return a schedule with the blocks of each queue in an order of all blocks, so that none waits for a later one.

    Where a block waits only for blocks before it in the order, the first one in the order that is not done waits for
    nothing, and it is at the front of its queue or has been taken: ranks never wait for each other in a circle.
    """
    place = {block: number for number, block in enumerate(order)}
    return Schedule(tuple(tuple(sorted(queue, key=place.__getitem__)) for queue in schedule.queues), schedule.steals)


def _equal_parts(blocks: int, ranks: int) -> tuple[tuple[int, ...], ...]:
    edges = [rank * blocks // ranks for rank in range(ranks + 1)]
    return tuple(tuple(range(begin, end)) for begin, end in pairwise(edges))


def _local_queues(held: NDArray[np.int64]) -> tuple[tuple[int, ...], ...]:
    """Give each block to a rank that holds most of its reads, at most an equal share of blocks to each rank.

    Pairs of a block and a rank are taken by the share of reads that the rank holds, largest first. A queue has the
    blocks with the largest share first, so that others steal those that its rank holds least of.
    """
    blocks, ranks = held.shape
    share = held / np.maximum(held.sum(axis=1, keepdims=True), 1)
    block, rank = np.nonzero(held)
    order = np.lexsort((rank, block, -share[block, rank]))
    room = [len(part) for part in _equal_parts(blocks, ranks)]
    queues: list[list[int]] = [[] for _ in range(ranks)]
    given = np.zeros(blocks, bool)
    for b, r in zip(block[order].tolist(), rank[order].tolist(), strict=True):
        if not given[b] and room[r]:
            given[b] = True
            room[r] -= 1
            queues[r].append(b)
    left = iter(np.flatnonzero(~given).tolist())
    for r, count in enumerate(room):
        queues[r] += [next(left) for _ in range(count)]
    return tuple(map(tuple, queues))


class QueueReader:
    """One rank's access to the queues of a schedule.

    Parameters
    ----------
    add : adds to the counter of a queue, and returns its value before
    rank : this rank
    """

    def __init__(self, schedule: Schedule, add: Callable[[int, int], int], rank: int) -> None:
        self._queues, self._add, self._own = schedule.queues, add, schedule.own(rank)
        count = len(schedule.queues) if schedule.steals else 1
        self._others = [(self._own + n) % len(schedule.queues) for n in range(1, count)]

    def take(self) -> tuple[int, bool] | None:
        """Return a block, and whether it is stolen; None if there is none left for this rank."""
        queue = self._queues[self._own]
        front, back = self._taken(self._own, 1)
        if front + back < len(queue):
            return queue[front], False
        while self._others:
            queue = self._queues[self._others[0]]
            front, back = self._taken(self._others[0], 1 << BACK_BITS)
            if front + back < len(queue):
                return queue[-1 - back], True
            del self._others[0]  # it stays empty
        return None

    def close(self) -> None:
        """Close all queues, so that no rank takes another block."""
        for number, queue in enumerate(self._queues):
            self._add(number, len(queue))

    def _taken(self, number: int, more: int) -> tuple[int, int]:
        before = self._add(number, more)
        return before & ((1 << BACK_BITS) - 1), before >> BACK_BITS


def dependency_order(after: Mapping[Node, Sequence[Node]], describe: Callable[[Node], str]) -> list[Node]:
    """Return all nodes in an order in which each comes behind those that it waits for.

    Parameters
    ----------
    after : nodes that each waits for

    Raises
    ------
    InputError
        Nodes wait for each other in a circle, or for one that there is not.
    """
    for node, others in after.items():
        for other in others:
            if other not in after:
                raise InputError(f"{describe(node)} waits for {describe(other)}, which is not run")
    try:
        return list(TopologicalSorter(after).static_order())
    except CycleError as error:
        circle = list(reversed(error.args[1]))
        text = " waits for ".join(map(describe, circle[:8])) + (" waits for …" if circle[8:] else "")
        raise InputError("blocks wait for each other without end", found=text, allowed="no circle") from None
