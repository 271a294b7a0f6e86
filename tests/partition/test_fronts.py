"""Fronts: as even as single bricks allow, and one image a rank from where a camera usually is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.errors import InputError
from clusterviz.partition import (
    PARALLEL_ORIGIN,
    BspTree,
    Split,
    build_tree,
    front_owners,
    owners_of,
    ray_origin,
    uniform_edges,
    units,
    visible_groups,
)
from clusterviz.partition.tree import Node, leaves_below

seeds = st.integers(0, 2**32 - 1)
past = st.one_of(st.floats(-9.0, -0.1), st.floats(8.1, 20.0))
BRICK = 8


def dealt(seed: int, ranks: int) -> tuple[BspTree, np.ndarray]:
    """A tree by even costs, and uneven ones; some bricks cost nothing."""
    rng = np.random.default_rng(seed)
    cost = np.floor(rng.random(rng.integers(1, 8, 3)) * 4) * rng.random()
    return build_tree(np.ones(cost.shape), ranks), cost


def nodes(node: Node) -> list[Split]:
    return [node, *nodes(node.low), *nodes(node.high)] if isinstance(node, Split) else []


@given(seeds, st.integers(1, 8), st.tuples(*[st.floats(-9, 20)] * 3), st.integers(1, 3))
def test_sides_are_within_half_a_unit_of_their_share(
    seed: int, ranks: int, eye: tuple[float, float, float], every: int
) -> None:
    tree, cost = dealt(seed, ranks)
    edges = uniform_edges(tree.shape_zyx, every)
    owner = front_owners(tree, cost, eye, edges).owner
    number = units(tree.shape_zyx, edges)
    dearest = float(np.bincount(number.ravel(), cost.ravel()).max())
    for unit in range(number.max() + 1):
        assert len(np.unique(owner[number == unit])) == 1
    for node in nodes(tree.root):
        low, high = ([leaf.rank for leaf in leaves_below(side)] for side in (node.low, node.high))
        below, above = (float(cost[np.isin(owner, side)].sum()) for side in (low, high))
        share = len(low) / (len(low) + len(high))
        assert abs(below - share * (below + above)) <= dearest / 2 + 1e-9


@given(seeds, st.integers(1, 8), st.tuples(past, past, past))
def test_an_eye_past_the_borders_along_all_axes_sees_one_image_a_rank(
    seed: int, ranks: int, eye: tuple[float, float, float]
) -> None:
    tree, cost = dealt(seed, ranks)
    owners = front_owners(tree, cost, eye)
    position = (eye[2] * BRICK, eye[1] * BRICK, eye[0] * BRICK)
    groups = visible_groups(owners, position, (1, 0, 0), BRICK)
    assert sorted(group.rank for group in groups) == sorted(set(owners.owner.flat))


@given(seeds, st.integers(1, 8), st.tuples(*[st.sampled_from([-1.0, -0.2, 0.3, 1.0])] * 3))
def test_parallel_rays_see_one_image_a_rank(seed: int, ranks: int, direction: tuple[float, float, float]) -> None:
    tree, cost = dealt(seed, ranks)
    owners = front_owners(tree, cost, ray_origin(None, direction, BRICK))
    groups = visible_groups(owners, None, direction, BRICK)
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


def test_other_bricks_than_the_trees_are_refused() -> None:
    with pytest.raises(InputError, match=r"not over the tree's bricks"):
        front_owners(build_tree(np.ones((1, 1, 2)), 2), np.ones((1, 1, 3)), PARALLEL_ORIGIN)
