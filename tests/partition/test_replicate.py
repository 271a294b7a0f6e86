"""Replication: only holders draw, and work flows round the ring."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.errors import InputError
from clusterviz.partition import UNASSIGNED, assign_replicas, build_tree, replicate
from clusterviz.partition.replicate import even_shares


@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 4))
def test_every_brick_is_drawn_by_a_holder(seed: int, ranks: int, copies: int) -> None:
    rng = np.random.default_rng(seed)
    shape = rng.integers(1, 6, 3)
    replicas = replicate(build_tree(np.ones(shape), ranks), min(copies, ranks))
    cost = np.floor(rng.random(shape) * 3)
    owners = assign_replicas(replicas, cost)
    assert ((owners.owner == UNASSIGNED) == (cost == 0)).all()
    for rank in range(ranks):
        assert not ((owners.owner == rank) & ~replicas.holds(rank)).any()


@given(st.lists(st.sampled_from([0.0, 1.0, 5.0, 40.0]), min_size=2, max_size=9), st.integers(1, 3))
def test_shares_are_as_even_as_holders_allow(totals: list[float], copies: int) -> None:
    ranks = len(totals)
    holders = np.arange(ranks)[:, None] + np.arange(min(copies, ranks))
    shares = even_shares(np.array(totals), holders % ranks)
    assert shares.min() >= 0
    np.testing.assert_allclose(shares.sum(axis=1), totals, atol=1e-9)
    # The least possible: some run of leaves on the ring has no more holders than this to flow to.
    runs = [
        sum(totals[(begin + k) % ranks] for k in range(length)) / min(ranks, length + min(copies, ranks) - 1)
        for begin in range(ranks)
        for length in range(1, ranks + 1)
    ]
    loads = np.bincount((holders % ranks).ravel(), shares.ravel(), minlength=ranks)
    assert loads.max() == pytest.approx(max(runs), rel=0.02, abs=1e-9)


def test_copies_balance_a_dear_corner() -> None:
    cost = np.ones((8, 8, 8))
    cost[:4, :4, :4] = 10
    home = build_tree(np.ones((8, 8, 8)), 4)
    imbalance = [assign_replicas(replicate(home, copies), cost).imbalance(cost) for copies in (1, 2, 4)]
    assert imbalance[0] > 1.7
    assert imbalance[1] < 0.75 * imbalance[0]
    assert imbalance[2] < 1.1


@pytest.mark.parametrize("copies", [0, 4])
def test_impossible_copies_are_refused(copies: int) -> None:
    with pytest.raises(InputError, match=r"1 … 3"):
        replicate(build_tree(np.ones((2, 2, 2)), 3), copies)
