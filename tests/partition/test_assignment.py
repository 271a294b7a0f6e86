"""Ways to assign bricks: who draws what, how even it is, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from clusterviz.errors import InputError
from clusterviz.partition import (
    UNASSIGNED,
    BspTree,
    Owners,
    Split,
    assign_replicas,
    bricks_of,
    build_tree,
    front_owners,
    front_to_back,
    interleave,
    owners_of,
    ray_origin,
    replicate,
    visible_groups,
)
from clusterviz.partition.replicate import even_shares
from clusterviz.partition.tree import Node, leaves_below

ONE = build_tree(np.ones((1, 1, 1)), 1)
SEEDS = st.integers(0, 2**32 - 1)
COSTS = arrays(np.float64, array_shapes(min_dims=3, max_dims=3, max_side=6), elements=st.sampled_from([0.0, 1.0, 2.5]))


def corner(dear: float) -> np.ndarray:
    cost = np.ones((8, 8, 8))
    cost[:4, :4, :4] = dear
    return cost


@given(COSTS, st.integers(1, 9), st.integers(1, 4))
def test_every_brick_that_costs_something_is_drawn_once(cost: np.ndarray, ranks: int, copies: int) -> None:
    tree, even = build_tree(cost, ranks), build_tree(np.ones(cost.shape), ranks)
    drawn = np.concatenate([bricks_of(tree, rank, cost) for rank in range(ranks)])
    assert sorted(map(tuple, drawn)) == list(map(tuple, np.argwhere(cost > 0)))
    dealt = interleave(cost, ranks).owner
    assert ((dealt == UNASSIGNED) == (cost == 0)).all()
    assert np.ptp(np.bincount(dealt[cost > 0], minlength=ranks)) <= 1
    replicas = replicate(even, min(copies, ranks))
    owner = assign_replicas(replicas, cost).owner
    assert ((owner == UNASSIGNED) == (cost == 0)).all()
    for rank in range(ranks):
        assert not ((owner == rank) & ~replicas.holds(rank)).any(), "only holders draw"
        assert owners_of(even).bricks(rank).tolist() == bricks_of(even, rank, np.ones(cost.shape)).tolist()


def test_loads_count_each_drawn_brick_once() -> None:
    owners = Owners(3, np.array([[[0, 1, UNASSIGNED, 0]]], np.int32))
    cost = np.array([[[1.0, 2.0, 50.0, 4.0]]])
    assert owners.loads(cost).tolist() == [5, 2, 0]
    assert owners.imbalance(cost) == pytest.approx(5 / (7 / 3))
    assert owners.bricks(0).tolist() == [[0, 0, 0], [0, 0, 3]]
    assert owners.imbalance(np.zeros((1, 1, 4))) == 1


def test_blocks_are_dealt_whole_and_a_dear_corner_is_shared_by_all() -> None:
    owner = interleave(np.ones((4, 4, 4)), 8, block=2).owner
    assert (owner[:2, :2, :2] == 0).all()
    assert sorted(owner[::2, ::2, ::2].flat) == list(range(8))
    assert interleave(corner(100), 4).imbalance(corner(100)) == 1


@given(st.lists(st.sampled_from([0.0, 1.0, 5.0, 40.0]), min_size=2, max_size=9), st.integers(1, 3))
def test_shares_of_replicas_are_as_even_as_holders_allow(totals: list[float], copies: int) -> None:
    ranks = len(totals)
    holders = (np.arange(ranks)[:, None] + np.arange(min(copies, ranks))) % ranks
    shares = even_shares(np.array(totals), holders)
    assert shares.min() >= 0
    np.testing.assert_allclose(shares.sum(axis=1), totals, atol=1e-9)
    # The least possible: some run of leaves on the ring has no more holders than this to flow to.
    runs = [
        sum(totals[(begin + k) % ranks] for k in range(length)) / min(ranks, length + min(copies, ranks) - 1)
        for begin in range(ranks)
        for length in range(1, ranks + 1)
    ]
    loads = np.bincount(holders.ravel(), shares.ravel(), minlength=ranks)
    assert loads.max() == pytest.approx(max(runs), rel=0.02, abs=1e-9)


def test_copies_balance_a_dear_corner() -> None:
    home = build_tree(np.ones((8, 8, 8)), 4)
    imbalance = [assign_replicas(replicate(home, copies), corner(10)).imbalance(corner(10)) for copies in (1, 2, 4)]
    assert imbalance[0] > 1.7
    assert imbalance[1] < 0.75 * imbalance[0]
    assert imbalance[2] < 1.1


def dealt(seed: int, ranks: int) -> tuple[BspTree, np.ndarray]:
    """A tree by even costs, and uneven ones; some bricks cost nothing."""
    rng = np.random.default_rng(seed)
    cost = np.floor(rng.random(rng.integers(1, 8, 3)) * 4) * rng.random()
    return build_tree(np.ones(cost.shape), ranks), cost


def nodes(node: Node) -> list[Split]:
    return [node, *nodes(node.low), *nodes(node.high)] if isinstance(node, Split) else []


@given(SEEDS, st.integers(1, 8), st.tuples(*[st.floats(-9, 20)] * 3))
def test_sides_of_fronts_are_within_half_a_brick_of_their_share(
    seed: int, ranks: int, eye: tuple[float, float, float]
) -> None:
    tree, cost = dealt(seed, ranks)
    owner, dearest = front_owners(tree, cost, eye).owner, float(cost.max())
    for node in nodes(tree.root):
        low, high = ([leaf.rank for leaf in leaves_below(side)] for side in (node.low, node.high))
        below, above = (float(cost[np.isin(owner, side)].sum()) for side in (low, high))
        share = len(low) / (len(low) + len(high))
        assert abs(below - share * (below + above)) <= dearest / 2 + 1e-9


PAST = st.floats(-9.0, -0.1) | st.floats(8.1, 20.0)
"""Beyond the borders of all bricks."""


@given(
    SEEDS,
    st.integers(1, 8),
    st.none() | st.tuples(PAST, PAST, PAST),
    st.tuples(*[st.sampled_from([-1.0, -0.2, 0.3, 1.0])] * 3),
)
def test_fronts_are_one_image_a_rank_from_where_a_camera_usually_is(
    seed: int, ranks: int, eye: tuple[float, float, float] | None, direction: tuple[float, float, float]
) -> None:
    tree, cost = dealt(seed, ranks)
    owners = front_owners(tree, cost, eye or ray_origin(None, direction))
    groups = visible_groups(owners, eye[::-1] if eye else None, direction)
    assert sorted(group.rank for group in groups) == sorted(set(owners.owner.flat))


def test_a_front_passes_through_a_layer_where_a_plane_cannot() -> None:
    cost = np.zeros((3, 4, 5))
    cost[1] = 1.0
    tree = BspTree((3, 4, 5), 2, build_tree(np.ones((3, 1, 1)), 2).root)
    y, x = np.mgrid[:4, :5]
    near_below = front_owners(tree, cost, (-5.0, -9.0, -9.0)).owner[1]
    near_above = front_owners(tree, cost, (-5.0, 9.0, 9.0)).owner[1]
    np.testing.assert_array_equal(near_below == 0, (x < 2) | ((x == 2) & (y < 2)))
    np.testing.assert_array_equal(near_above == 0, (x > 2) | ((x == 2) & (y > 1)), "the near go to the near side")


def test_fronts_balance_what_whole_layers_cannot() -> None:
    axes = np.meshgrid(*[np.linspace(0, 1, 12)] * 3, indexing="ij")
    cost = 0.01 + np.exp(-sum((axis - 0.2) ** 2 for axis in axes) / 0.1)
    tree = build_tree(cost, 7)
    assert owners_of(tree).imbalance(cost) > 1.1
    assert front_owners(tree, cost).imbalance(cost) < 1.05


@pytest.mark.parametrize(("way", "of"), [(visible_groups, interleave(np.ones((1, 1, 1)), 1)), (front_to_back, ONE)])
@pytest.mark.parametrize(
    ("eye", "forward"), [((math.nan, 0, 0), (1, 0, 0)), ((math.inf, 0, 0), (1, 0, 0)), (None, (math.nan, 0, 0))]
)
def test_cameras_that_are_not_finite_are_refused(
    way: Callable[..., object], of: object, eye: Any, forward: Any
) -> None:
    with pytest.raises(InputError, match="not finite"):
        way(of, eye, forward)
