"""Interleaving: counts differ by one block at most, and neighbours go to different ranks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.errors import InputError
from clusterviz.partition import UNASSIGNED, interleave


@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_counts_differ_by_one_brick_at_most(seed: int, ranks: int) -> None:
    rng = np.random.default_rng(seed)
    cost = np.floor(rng.random(rng.integers(1, 7, 3)) * 3)
    owners = interleave(cost, ranks)
    counts = np.bincount(owners.owner[cost > 0], minlength=ranks)
    assert np.ptp(counts) <= 1
    assert ((owners.owner == UNASSIGNED) == (cost == 0)).all()


def test_a_block_is_dealt_whole() -> None:
    owner = interleave(np.ones((4, 4, 4)), 8, block=2).owner
    assert (owner[:2, :2, :2] == 0).all()
    assert sorted(owner[::2, ::2, ::2].flat) == list(range(8))


def test_a_dear_corner_is_shared_by_all() -> None:
    cost = np.ones((8, 8, 8))
    cost[:4, :4, :4] = 100
    assert interleave(cost, 4).imbalance(cost) == 1


@pytest.mark.parametrize(("ranks", "block"), [(0, 1), (2, 0)])
def test_impossible_numbers_are_refused(ranks: int, block: int) -> None:
    with pytest.raises(InputError):
        interleave(np.ones((1, 1, 1)), ranks, block)
