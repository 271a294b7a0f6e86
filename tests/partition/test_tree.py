"""Trees: every brick once, costs shared well, ties decided the same way everywhere; searches and moves of planes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from clusterviz.partition import (
    BrickBox,
    BspTree,
    Leaf,
    Node,
    Split,
    build_tree,
    busiest,
    move_planes,
    owners_of,
    refined_edges,
    search_tree,
    units,
)

COSTS = arrays(
    np.float64,
    array_shapes(min_dims=3, max_dims=3, max_side=5),
    elements=st.just(0.0) | st.floats(0, 1e12) | st.integers(0, 3).map(float),
)
SEEDS = st.integers(0, 2**32 - 1)


def loads(tree: BspTree) -> list[float]:
    return [leaf.cost for leaf in tree.leaves]


def planes(node: Node) -> list[tuple[int, int]]:
    """Axis and place of all planes."""
    return [] if isinstance(node, Leaf) else [(node.axis_zyx, node.plane), *planes(node.low), *planes(node.high)]


def check_partition(tree: BspTree, cost: np.ndarray, ranks: int) -> None:
    """Every brick is in one leaf, every rank has one, and planes lie between their two sides."""
    covered = np.zeros(cost.shape, int)
    for rank, leaf in enumerate(tree.leaves):
        assert leaf.rank == rank
        assert leaf.cost == pytest.approx(cost[leaf.box.slices].sum())
        assert leaf.box.bricks == covered[leaf.box.slices].size
        covered[leaf.box.slices] += 1
        inside = cost[leaf.trimmed.slices]
        assert np.count_nonzero(inside) == np.count_nonzero(cost[leaf.box.slices]), "trimmed boxes hold all cost"
        if leaf.trimmed.bricks:
            assert all((a >= b) for a, b in zip(leaf.trimmed.begin_zyx, leaf.box.begin_zyx, strict=True))
            assert all(inside.take(end, axis).any() for axis in range(3) for end in (0, -1)), "and touch it"
    assert (covered == 1).all()

    def check(node: Node) -> list[Leaf]:
        if isinstance(node, Leaf):
            return [node]
        low, high = check(node.low), check(node.high)
        assert all(leaf.box.end_zyx[node.axis_zyx] <= node.plane for leaf in low)
        assert all(leaf.box.begin_zyx[node.axis_zyx] >= node.plane for leaf in high)
        return low + high

    assert len(check(tree.root)) == ranks


@given(COSTS, st.integers(1, 40))
def test_a_tree_is_a_partition(cost: np.ndarray, ranks: int) -> None:
    tree = build_tree(cost, ranks)
    check_partition(tree, cost, ranks)

    def halves(node: Node, count: int) -> None:
        assert isinstance(node, Split) == (count > 1)
        if isinstance(node, Split):
            halves(node.low, count // 2)
            halves(node.high, count - count // 2)

    halves(tree.root, ranks)


@settings(max_examples=50)
@given(SEEDS, st.integers(1, 12))
def test_searched_and_moved_trees_are_partitions(seed: int, ranks: int) -> None:
    rng = np.random.default_rng(seed)
    cost = np.floor(rng.random(rng.integers(1, 12, 3)) * 5)
    searched, tree = search_tree(cost, ranks), build_tree(cost, ranks)
    check_partition(searched, cost, ranks)
    assert busiest(searched.root) <= busiest(tree.root) * (1 + 1e-9)
    check_partition(move_planes(build_tree(np.ones(cost.shape), ranks), cost), cost, ranks)


@given(COSTS, st.integers(1, 12), st.sampled_from([2.0**-40, 0.5, 3.0, 1e6]))
def test_the_unit_of_cost_does_not_matter(cost: np.ndarray, ranks: int, unit: float) -> None:
    cost = np.round(cost)
    assert [a.box for a in build_tree(cost, ranks).leaves] == [a.box for a in build_tree(cost * unit, ranks).leaves]


def test_costs_are_shared_well() -> None:
    for ranks in (1, 2, 4, 8, 16, 32, 64):
        assert loads(build_tree(np.full((4, 4, 4), 0.1), ranks)) == pytest.approx([6.4 / ranks] * ranks)
    cost = np.random.default_rng(3).random((16, 16, 16))
    for ranks in (2, 3, 5, 7, 12, 31):
        assert max(loads(build_tree(cost, ranks))) <= 1.25 * cost.sum() / ranks
    assert loads(build_tree(np.array([[[100.0, 1, 1, 1]]]), 4)) == [100, 1, 1, 1], "one dear brick leaves none idle"
    assert set(loads(build_tree(np.ones((16, 16, 16)), 4096))) == {1.0}, "thousands of ranks are no deep recursion"
    # Seven ranks share eight layers better than by halves.
    assert owners_of(search_tree(np.ones((8, 8, 8)), 7)).imbalance(np.ones((8, 8, 8))) < 1.1


@given(st.integers(1, 30), st.data())
def test_a_row_of_bricks_feeds_every_rank_it_can(bricks: int, data: st.DataObject) -> None:
    cost = data.draw(arrays(np.float64, (1, bricks, 1), elements=st.floats(0.01, 100)))
    ranks = data.draw(st.integers(1, bricks))
    assert all(leaf.trimmed.bricks for leaf in build_tree(cost, ranks).leaves)


def test_empty_leaves_where_there_are_more_ranks_than_bricks_or_no_costs() -> None:
    tree = build_tree(np.ones((1, 1, 2)), 5)
    assert sorted(loads(tree)) == [0, 0, 0, 1, 1]
    assert sum(leaf.box.bricks for leaf in tree.leaves) == 2
    free = build_tree(np.zeros((2, 2, 2)), 8)
    assert all(leaf.box.bricks == 1 and leaf.trimmed.bricks == 0 for leaf in free.leaves)


def test_ties_take_the_longest_axis_its_middle_and_that_of_a_gap() -> None:
    def root(cost: np.ndarray) -> tuple[int, int]:
        return planes(build_tree(cost, 2).root)[0]

    assert root(np.full((4, 2, 6), 0.1)) == (2, 3)
    assert root(np.full((3, 3, 3), 0.1))[0] == 0
    assert root(np.array([[[1.0, 0, 0, 0, 0, 0, 1]]]))[1] in (3, 4)
    assert [leaf.trimmed for leaf in build_tree(np.array([[[1.0, 0, 0, 1]]]), 2).leaves] == [
        BrickBox((0, 0, 0), (1, 1, 1)),
        BrickBox((0, 0, 3), (1, 1, 4)),
    ]


def test_a_plane_follows_the_cost() -> None:
    tree = build_tree(np.ones((1, 1, 10)), 2)
    cost = np.array([[[6.0, 1, 1, 1, 1, 1, 1, 0, 0, 0]]])
    assert [leaf.box.bricks for leaf in move_planes(tree, cost).leaves] == [1, 9]
    cost = np.array([[[1.0, 1, 1, 1, 2.2, 1, 1, 1, 1, 1]]])
    assert move_planes(tree, cost * np.array([3.0] + [1] * 9)).leaves[0].box.bricks < 5


@given(SEEDS, st.integers(1, 8), st.integers(1, 3))
def test_planes_are_refined_edges_with_single_bricks_beside_them(seed: int, coarsest: int, fine: int) -> None:
    rng = np.random.default_rng(seed)
    tree = build_tree(rng.random(rng.integers(1, 40, 3)), int(rng.integers(1, 9)))
    edges = [(0, *own, count) for own, count in zip(refined_edges(tree, coarsest, fine), tree.shape_zyx, strict=True)]
    for own in edges:
        assert list(own) == sorted(set(own))
        assert max(np.diff(own)) <= coarsest
    for axis, plane in planes(tree.root):
        if 0 < plane < tree.shape_zyx[axis]:
            assert {plane, plane - 1, plane + 1} <= set(edges[axis])


def test_units_grow_away_from_a_plane_and_are_the_boxes_between_edges() -> None:
    away = (1, 2, 4, 6, 10, 14, 22, 30)
    edges = refined_edges(build_tree(np.ones((1, 1, 64)), 2), 8, 2)[2]
    assert edges == (*(32 - d for d in reversed(away)), 32, *(32 + d for d in away))
    assert refined_edges(build_tree(np.ones((9, 4, 1)), 1), 4) == ((4, 8), (), ()), "as coarse as allowed"
    number = units((1, 3, 5), ((), (2,), (2, 4)))
    assert number.tolist() == [[[0, 0, 1, 1, 2], [0, 0, 1, 1, 2], [3, 3, 4, 4, 5]]]
