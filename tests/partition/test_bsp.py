"""The tree: every brick once, costs shared well, ties decided the same way everywhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from clusterviz.errors import InputError
from clusterviz.partition import BrickBox, BspTree, Leaf, Node, Split, build_tree, draw

costs = arrays(
    np.float64,
    array_shapes(min_dims=3, max_dims=3, max_side=5),
    elements=st.one_of(st.just(0.0), st.floats(0, 1e12), st.integers(0, 3).map(float)),
)


def loads(tree: BspTree) -> list[float]:
    return [leaf.cost for leaf in tree.leaves]


@given(costs, st.integers(1, 40))
def test_every_brick_is_in_one_leaf_and_every_rank_has_one(cost: np.ndarray, ranks: int) -> None:
    tree = build_tree(cost, ranks)
    assert [leaf.rank for leaf in tree.leaves] == list(range(ranks))
    owners = np.zeros(cost.shape, int)
    for leaf in tree.leaves:
        owners[leaf.box.slices] += 1
        assert leaf.cost == cost[leaf.box.slices].sum()
        assert leaf.box.bricks == owners[leaf.box.slices].size
    assert (owners == 1).all()


@given(costs, st.integers(1, 40))
def test_trimmed_boxes_hold_all_cost_and_touch_it_on_every_side(cost: np.ndarray, ranks: int) -> None:
    for leaf in build_tree(cost, ranks).leaves:
        inside = cost[leaf.trimmed.slices]
        assert np.count_nonzero(inside) == np.count_nonzero(cost[leaf.box.slices])
        if leaf.trimmed.bricks:
            assert all((a >= b) for a, b in zip(leaf.trimmed.begin_zyx, leaf.box.begin_zyx, strict=True))
            for axis in range(3):
                assert inside.take(0, axis).any()
                assert inside.take(-1, axis).any()


@given(costs, st.integers(2, 40))
def test_planes_lie_between_the_two_sides(cost: np.ndarray, ranks: int) -> None:
    def check(node: Node, count: int) -> list[Leaf]:
        if isinstance(node, Leaf):
            assert count == 1
            return [node]
        low, high = check(node.low, count // 2), check(node.high, count - count // 2)
        assert all(leaf.box.end_zyx[node.axis_zyx] <= node.plane for leaf in low)
        assert all(leaf.box.begin_zyx[node.axis_zyx] >= node.plane for leaf in high)
        return low + high

    assert len(check(build_tree(cost, ranks).root, ranks)) == ranks


@given(costs, st.integers(1, 12), st.sampled_from([2.0**-40, 0.5, 3.0, 1e6]))
def test_the_unit_of_cost_does_not_matter(cost: np.ndarray, ranks: int, unit: float) -> None:
    cost = np.round(cost)
    assert [a.box for a in build_tree(cost, ranks).leaves] == [a.box for a in build_tree(cost * unit, ranks).leaves]


@pytest.mark.parametrize("ranks", [1, 2, 4, 8, 16, 32, 64])
def test_equal_costs_are_shared_equally(ranks: int) -> None:
    assert loads(build_tree(np.full((4, 4, 4), 0.1), ranks)) == pytest.approx([6.4 / ranks] * ranks)


@pytest.mark.parametrize("ranks", [2, 3, 5, 7, 12, 31])
def test_random_costs_are_shared_within_a_brick_or_two(ranks: int) -> None:
    cost = np.random.default_rng(3).random((16, 16, 16))
    assert max(loads(build_tree(cost, ranks))) <= 1.25 * cost.sum() / ranks


def test_one_dear_brick_leaves_no_rank_idle() -> None:
    assert loads(build_tree(np.array([[[100.0, 1, 1, 1]]]), 4)) == [100, 1, 1, 1]


@given(st.integers(1, 30), st.data())
def test_a_row_of_bricks_feeds_every_rank_it_can(bricks: int, data: st.DataObject) -> None:
    cost = data.draw(arrays(np.float64, (1, bricks, 1), elements=st.floats(0.01, 100)))
    ranks = data.draw(st.integers(1, bricks))
    assert all(leaf.trimmed.bricks for leaf in build_tree(cost, ranks).leaves)


def test_more_ranks_than_bricks_leave_empty_leaves() -> None:
    tree = build_tree(np.ones((1, 1, 2)), 5)
    assert sorted(loads(tree)) == [0, 0, 0, 1, 1]
    assert sum(leaf.box.bricks for leaf in tree.leaves) == 2


def test_no_cost_at_all_still_divides_the_bricks() -> None:
    tree = build_tree(np.zeros((2, 2, 2)), 8)
    assert all(leaf.box.bricks == 1 and leaf.trimmed.bricks == 0 for leaf in tree.leaves)


def test_ties_take_the_longest_axis_and_its_middle() -> None:
    root = build_tree(np.full((4, 2, 6), 0.1), 2).root
    assert isinstance(root, Split)
    assert (root.axis_zyx, root.plane) == (2, 3)
    cube = build_tree(np.full((3, 3, 3), 0.1), 2).root
    assert isinstance(cube, Split)
    assert cube.axis_zyx == 0


def test_a_gap_is_cut_in_its_middle() -> None:
    root = build_tree(np.array([[[1.0, 0, 0, 0, 0, 0, 1]]]), 2).root
    assert isinstance(root, Split)
    assert root.plane in (3, 4)
    assert [leaf.trimmed for leaf in build_tree(np.array([[[1.0, 0, 0, 1]]]), 2).leaves] == [
        BrickBox((0, 0, 0), (1, 1, 1)),
        BrickBox((0, 0, 3), (1, 1, 4)),
    ]


def test_thousands_of_ranks_are_no_deep_recursion() -> None:
    tree = build_tree(np.ones((16, 16, 16)), 4096)
    assert set(loads(tree)) == {1.0}


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_bad_costs_are_refused(bad: float) -> None:
    with pytest.raises(InputError, match="cost"):
        build_tree(np.array([[[1.0, bad]]]), 1)


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(InputError, match="found 0"):
        build_tree(np.ones((1, 1, 1)), 0)
    for shape in ((2, 2), (0, 2, 2)):
        with pytest.raises(InputError, match="shape"):
            build_tree(np.ones(shape), 1)


def test_drawing() -> None:
    assert draw(build_tree(np.ones((1, 1, 1)), 1)).splitlines() == [
        "1 × 1 × 1 bricks (z, y, x) on 1 rank",
        "└─ rank 0: z 0…1, y 0…1, x 0…1, cost 1",
    ]
    assert draw(build_tree(np.ones((1, 1, 2)), 4)).splitlines() == [
        "1 × 1 × 2 bricks (z, y, x) on 4 ranks",
        "└─ x = 1",
        "   ├─ z = 1",
        "   │  ├─ rank 0: z 0…1, y 0…1, x 0…1, cost 1",
        "   │  └─ rank 1: no bricks",
        "   └─ z = 1",
        "      ├─ rank 2: z 0…1, y 0…1, x 1…2, cost 1",
        "      └─ rank 3: no bricks",
    ]
