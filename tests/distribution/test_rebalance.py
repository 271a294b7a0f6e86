"""Moves of a frame: within the budget and the memory, best gain a byte first, always towards the goal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.distribution.balancer import Goal, rebalance
from clusterviz.errors import InputError
from clusterviz.partition import Owners

ROOMY = np.full(8, 10**9)


def wish(target: list[int], cost: list[float], wire: list[int], unit: list[int] | None = None) -> Goal:
    """A row of bricks."""
    sizes = np.array([[wire]])
    numbers = np.array([[unit if unit is not None else list(range(len(target)))]])
    return Goal(Owners(8, np.array([[target]], np.int32)), np.array([[cost]]), sizes, sizes, numbers)


def row(owner: list[int]) -> Owners:
    return Owners(8, np.array([[owner]], np.int32))


@given(st.integers(0, 2**32 - 1), st.integers(20, 200))
def test_budget_and_memory_hold_and_all_moves_are_wished(seed: int, budget: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 6, 3))
    present, target = (Owners(4, rng.integers(-1, 4, shape).astype(np.int32)) for _ in range(2))
    size = rng.integers(0, 20, shape)
    wanted = Goal(target, rng.random(shape), size, size, rng.integers(0, 10, shape))
    free, moving = rng.integers(0, 60, 4), rng.random(shape) < 0.2
    moves = rebalance(present, wanted, free, budget, moving)
    assert sum(move.wire_bytes for move in moves) <= budget
    assert len({move.brick for move in moves}) == len(moves)
    taken = np.zeros(4, int)
    for move in moves:
        taken[move.target] += size[move.brick]
        assert not moving[move.brick]
        assert (move.source, move.target) == (present.owner[move.brick], target.owner[move.brick])
        assert move.source != move.target
    assert (taken <= free).all()


@given(st.integers(0, 2**32 - 1))
def test_enough_frames_reach_what_is_wished(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 5, 3))
    owner, target = (rng.integers(0, 3, shape).astype(np.int32) for _ in range(2))
    size = rng.integers(1, 9, shape)
    wanted = Goal(Owners(3, target), rng.random(shape), size, size, np.zeros(shape, int))
    for _ in range(owner.size):
        for move in rebalance(Owners(3, owner), wanted, ROOMY, 10):
            owner[move.brick] = move.target
    assert (owner == target).all()


MOST_GAIN = wish([1, 1, 1, 0], [4.0, 2.0, 2.0, 9.0], [40, 10, 30, 1])
UNIT = wish([1, 1, 1, 1], [1.0, 1, 1, 9], [10] * 4, unit=[0, 0, 0, 1])


@pytest.mark.parametrize(
    ("owner", "wanted", "free", "budget", "moved"),
    [
        ([0, 0, 0, 0], MOST_GAIN, ROOMY, 80, [1, 0, 2]),
        ([0, 0, 0, 0], MOST_GAIN, ROOMY, 45, [1, 2]),
        # Rank 1 has less than rank 2 until rank 0 has given to it.
        ([0, 0, 1, 2], wish([0, 1, 2, 2], [8.0, 8.0, 3.0, 4.0], [10] * 4), ROOMY, 100, [1, 2]),
        ([0, 0], wish([1, 1], [2.0, 2.0], [0, 10]), ROOMY, 5, [0]),
        ([0, 0, 0, 0], UNIT, ROOMY, 35, [3]),
        ([0, 0, 0, 1], UNIT, ROOMY, 35, [0, 1, 2]),
        ([0, 0], wish([1, 2], [1.0, 1.0], [10, 10]), np.array([0, 9, 10, 0, 0, 0, 0, 0]), 100, [1]),
        ([0, 1], wish([0, 1], [1.0, 1.0], [10, 10]), ROOMY, 0, []),
    ],
    ids=[
        "most gain a byte goes first",
        "within the budget",
        "what gains nothing yet goes last",
        "what is cached costs no budget",
        "the dearest unit",
        "a unit goes whole if a frame can carry it",
        "a full rank gets nothing",
        "nothing to do",
    ],
)
def test_moves_of_a_frame(owner: list[int], wanted: Goal, free: np.ndarray, budget: int, moved: list[int]) -> None:
    assert [move.brick[2] for move in rebalance(row(owner), wanted, free, budget)] == moved


def test_a_unit_that_no_frame_can_carry_goes_in_parts_and_less_than_a_brick_is_refused() -> None:
    assert len(rebalance(row([0, 0, 0, 1]), UNIT, ROOMY, 25)) == 2
    with pytest.raises(InputError, match="allowed 10 bytes"):
        rebalance(row([0]), wish([1], [1.0], [10]), ROOMY, 9)
