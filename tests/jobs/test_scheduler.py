"""Schedules, as pure functions: every block once, where its reads are, and never in a circle."""

from __future__ import annotations

import random

import numpy as np
import pytest

from clusterviz.errors import InputError
from clusterviz.jobs.scheduler import SCHEDULES, QueueReader, Schedule, dependency_order, in_order, make_schedule


def taken_by(schedule: Schedule, ranks: int, seed: int, speeds: list[float] | None = None) -> list[list[int]]:
    """Return the blocks that each rank takes; the ranks' turns are drawn at random, by their speeds."""
    rng, counters = random.Random(seed), [0] * len(schedule.queues)

    def add(number: int, more: int) -> int:
        counters[number] += more
        return counters[number] - more

    readers = {rank: QueueReader(schedule, add, rank) for rank in range(ranks)}
    found: list[list[int]] = [[] for _ in range(ranks)]
    while readers:
        (rank,) = rng.choices([*readers], [(speeds or [1.0] * ranks)[rank] for rank in readers])
        if (taken := readers[rank].take()) is None:
            del readers[rank]
        else:
            found[rank].append(taken[0])
    return found


@pytest.mark.parametrize("name", SCHEDULES)
@pytest.mark.parametrize(("blocks", "ranks"), [(0, 3), (1, 7), (24, 5), (100, 3)])
def test_every_block_is_taken_once(name: str, blocks: int, ranks: int) -> None:
    held = np.random.default_rng(blocks).integers(0, 5, (blocks, ranks))
    schedule = make_schedule(name, blocks, ranks, held)  # type: ignore[arg-type]
    for seed in range(5):
        found = taken_by(schedule, ranks, seed)
        assert sorted(block for each in found for block in each) == list(range(blocks))


def test_a_rank_gets_the_blocks_whose_reads_it_holds() -> None:
    owners = np.random.default_rng(3).permutation(np.arange(60) % 4)
    held = np.where(np.arange(4) == owners[:, None], 900, 100)
    queues = make_schedule("local", 60, 4, held).queues
    assert [{int(owners[block]) for block in queue} for queue in queues] == [{0}, {1}, {2}, {3}]


def test_no_rank_gets_more_than_its_share_though_it_holds_all() -> None:
    held = np.zeros((11, 3), np.int64)
    held[:, 1] = 8
    assert sorted(map(len, make_schedule("local", 11, 3, held).queues)) == [3, 4, 4]


def test_blocks_of_a_slow_rank_go_elsewhere() -> None:
    schedule = make_schedule("local", 90, 3)
    found = taken_by(schedule, 3, seed=1, speeds=[1.0, 20.0, 20.0])
    assert len(found[0]) < 12
    assert found[0] == list(range(len(found[0])))  # from the front; the others take from the back
    assert [len(each) for each in taken_by(make_schedule("static", 90, 3), 3, 1, [1.0, 20.0, 20.0])] == [30, 30, 30]


def test_a_closed_queue_has_no_blocks() -> None:
    counters = [0, 0]

    def add(number: int, more: int) -> int:
        counters[number] += more
        return counters[number] - more

    readers = [QueueReader(make_schedule("local", 10, 2), add, rank) for rank in range(2)]
    assert readers[0].take() == (0, False)
    readers[0].close()
    readers[1].close()
    assert [reader.take() for reader in readers] == [None, None]


@pytest.mark.parametrize("name", SCHEDULES)
def test_ranks_never_wait_for_each_other_in_a_circle(name: str) -> None:
    """Each rank runs what it has taken only when all before it in a random graph is done."""
    rng = random.Random(5)
    after = {n: rng.sample(range(n), min(n, 3)) for n in range(60)}
    order = dependency_order(after, str)
    for seed in range(10):
        schedule = in_order(make_schedule(name, 60, 4, seed=seed), order)  # type: ignore[arg-type]
        done, turns, counters = set[int](), random.Random(seed), [0] * len(schedule.queues)

        def add(number: int, more: int, counters: list[int] = counters) -> int:
            counters[number] += more
            return counters[number] - more

        readers = [QueueReader(schedule, add, rank) for rank in range(4)]
        waiting: dict[int, int | None] = dict.fromkeys(range(4), -1)
        while len(done) < 60:
            ready = [
                r
                for r, block in waiting.items()
                if block == -1 or (block is not None and done.issuperset(after[block]))
            ]
            assert ready, "all ranks wait"
            rank = turns.choice(ready)
            if (block := waiting[rank]) is not None and block >= 0:
                done.add(block)
            taken = readers[rank].take()
            waiting[rank] = taken[0] if taken else None


def test_a_circle_of_dependencies_is_named() -> None:
    with pytest.raises(InputError, match="blocks wait for each other without end") as raised:
        dependency_order({"a": ["b"], "b": ["c"], "c": ["b"], "d": []}, str)
    assert "b waits for c waits for b" in str(raised.value) or "c waits for b waits for c" in str(raised.value)
    with pytest.raises(InputError, match="no such schedule; found fastest; allowed local, shared, static, random"):
        make_schedule("fastest", 3, 2)  # type: ignore[arg-type]
