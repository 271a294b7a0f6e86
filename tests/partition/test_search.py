"""The search for trees and the moving of planes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.errors import InputError
from clusterviz.partition import BspTree, build_tree, busiest, move_planes, owners_of, search_tree, uniform_edges


def random_cost(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.floor(rng.random(rng.integers(1, 7, 3)) * 5)


def assert_is_a_partition(tree: BspTree, cost: np.ndarray) -> None:
    covered = np.zeros(cost.shape, int)
    for rank, leaf in enumerate(tree.leaves):
        assert leaf.rank == rank
        assert leaf.cost == pytest.approx(cost[leaf.box.slices].sum())
        covered[leaf.box.slices] += 1
    assert (covered == 1).all()


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_a_search_is_a_partition_and_no_worse_than_the_plain_tree(seed: int, ranks: int) -> None:
    cost = random_cost(seed)
    tree = search_tree(cost, ranks)
    assert_is_a_partition(tree, cost)
    assert busiest(tree.root) <= busiest(build_tree(cost, ranks).root) * (1 + 1e-9)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 3))
def test_moved_planes_are_a_partition(seed: int, ranks: int, every: int) -> None:
    cost = random_cost(seed)
    tree = build_tree(np.ones(cost.shape), ranks)
    assert_is_a_partition(move_planes(tree, cost, uniform_edges(tree.shape_zyx, every)), cost)


def test_seven_ranks_share_eight_layers_better_than_by_halves() -> None:
    cost = np.ones((8, 8, 8))
    assert owners_of(search_tree(cost, 7)).imbalance(cost) < 1.1


def test_a_plane_follows_the_cost() -> None:
    tree = build_tree(np.ones((1, 1, 10)), 2)
    cost = np.array([[[6.0, 1, 1, 1, 1, 1, 1, 0, 0, 0]]])
    assert [leaf.box.bricks for leaf in move_planes(tree, cost).leaves] == [1, 9]


def test_a_plane_stays_where_little_is_won() -> None:
    tree = build_tree(np.ones((1, 1, 10)), 2)
    cost = np.array([[[1.0, 1, 1, 1, 1.4, 1, 1, 1, 1, 1]]])
    cost[0, 0, 4] = 2.2
    assert move_planes(tree, cost, still=0.3).leaves[0].box.bricks == 5
    assert move_planes(tree, cost * np.array([3.0] + [1] * 9), still=0.0).leaves[0].box.bricks < 5


def test_costs_over_other_bricks_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(1, 1, 2\)"):
        move_planes(build_tree(np.ones((1, 1, 2)), 2), np.ones((1, 1, 3)))
