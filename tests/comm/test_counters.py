"""Counters and work queues: each item is taken once, also while rank 0 makes no MPI calls."""

from __future__ import annotations

import random
import time

import pytest

from clusterviz.comm import Channel, LoopbackChannel, ThrottledChannel, WorkQueue, run_loopback
from clusterviz.comm.mpi import MpiChannel

ITEMS = 400


def check_counters(channel: Channel) -> None:
    """Check that ranks take from one counter at once, twice with a reset between; another counter is unchanged."""
    counters = channel.counters(2)
    for turn in range(2):
        taken = []
        while (item := counters.add(0, 1)) < ITEMS:
            taken.append(item)
        assert taken == sorted(taken)
        everybody = channel.allgather(taken)
        assert sorted(item for items in everybody for item in items) == list(range(ITEMS)), turn
        assert counters.add(0, 0) == ITEMS + channel.size
        assert counters.add(1, 0) == 0
        counters.reset()
        assert counters.add(0, 0) == 0
        channel.barrier()
    counters.add(1, -3)
    channel.barrier()
    assert counters.add(1, 0) == -3 * channel.size
    for index in (-1, 2):
        with pytest.raises(IndexError, match=f"no counter {index} of 2"):
            counters.add(index, 1)
    counters.free()


@pytest.mark.parametrize("ranks", [1, 3, 8])
def test_threads_take_from_one_queue(ranks: int) -> None:
    run_loopback(ranks, check_counters)


def test_a_slow_link_has_counters_too() -> None:
    check_counters(ThrottledChannel(LoopbackChannel(), 1e6))


def check_queue(channel: Channel, groups: int) -> None:
    """Check, twice, that each item goes to one group, and to all of its members in the same order."""
    group = channel.rank * groups // channel.size
    queue = WorkQueue(channel, ITEMS, group, groups, groups == channel.size)
    for items in (ITEMS, 7):
        queue.start()
        dawdle, taken = random.Random(channel.rank + items), []
        for item in queue.take(items):
            taken.append(item)
            if dawdle.random() < 0.02:
                time.sleep(0.001)
        everybody = channel.allgather((group, taken))
        by_group = {number: [found for member, found in everybody if member == number] for number in range(groups)}
        assert all(found == members[0] for members in by_group.values() for found in members)
        assert sorted(item for members in by_group.values() for item in members[0]) == list(range(items))
    queue.free()


@pytest.mark.parametrize(("ranks", "groups"), [(1, 1), (5, 5), (5, 2), (8, 3), (4, 1)])
def test_groups_of_threads_take_from_one_queue(ranks: int, groups: int) -> None:
    run_loopback(ranks, lambda channel: check_queue(channel, groups))


@pytest.mark.mpi(ranks=[5], timeout=60)
def test_processes_take_from_one_queue(mpi_ranks: int) -> None:
    channel = MpiChannel()
    check_counters(channel)
    for groups in (2, 5):
        check_queue(channel, groups)
    _check_rank_0_need_not_help(channel)
    channel.close()


def _check_rank_0_need_not_help(channel: MpiChannel) -> None:
    """Check that the others empty the queue while rank 0 sleeps without MPI calls."""
    counters = channel.counters(1)
    if channel.rank == 0:
        time.sleep(0.7)
    taken = 0
    while counters.add(0, 1) < ITEMS:
        taken += 1
    everybody = channel.allgather(taken)
    assert sum(everybody) == ITEMS
    assert everybody[0] == 0
    counters.free()
