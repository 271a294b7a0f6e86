"""Edges: uniform ones, and those that are fine near planes only."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.errors import InputError
from clusterviz.partition import BspTree, build_tree, refined_edges, search_tree, uniform_edges, units
from clusterviz.partition.tree import Leaf, Node


def planes(node: Node) -> list[tuple[int, int]]:
    """Axis and place of all planes."""
    return [] if isinstance(node, Leaf) else [(node.axis_zyx, node.plane), *planes(node.low), *planes(node.high)]


def random_tree(seed: int) -> BspTree:
    rng = np.random.default_rng(seed)
    return build_tree(rng.random(rng.integers(1, 40, 3)), int(rng.integers(1, 9)))


@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(1, 3))
def test_planes_are_edges_with_single_bricks_beside_them(seed: int, coarsest: int, fine: int) -> None:
    tree = random_tree(seed)
    edges = refined_edges(tree, coarsest, fine)
    for axis, count in enumerate(tree.shape_zyx):
        own = [0, *edges[axis], count]
        assert own == sorted(set(own))
        assert max(np.diff(own)) <= coarsest
    for axis, plane in planes(tree.root):
        if 0 < plane < tree.shape_zyx[axis]:
            assert {plane, plane - 1, plane + 1} <= {0, *edges[axis], tree.shape_zyx[axis]}


def test_units_grow_away_from_a_plane() -> None:
    tree = build_tree(np.ones((1, 1, 64)), 2)
    away = (1, 2, 4, 6, 10, 14, 22, 30)
    assert refined_edges(tree, 8, 2)[2] == (*(32 - d for d in reversed(away)), 32, *(32 + d for d in away))


def test_without_planes_units_are_as_coarse_as_allowed() -> None:
    assert refined_edges(build_tree(np.ones((9, 4, 1)), 1), 4) == ((4, 8), (), ())


def test_units_are_the_boxes_between_edges() -> None:
    number = units((1, 3, 5), uniform_edges((1, 3, 5), 2))
    assert number.tolist() == [[[0, 0, 1, 1, 2], [0, 0, 1, 1, 2], [3, 3, 4, 4, 5]]]


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_a_search_keeps_planes_on_edges(seed: int, every: int) -> None:
    rng = np.random.default_rng(seed)
    cost = rng.random(rng.integers(1, 12, 3))
    edges = uniform_edges(cost.shape, every)
    for axis, plane in planes(search_tree(cost, int(rng.integers(1, 8)), edges).root):
        assert plane in {0, *edges[axis], cost.shape[axis]}


@pytest.mark.parametrize("call", [lambda t: uniform_edges((1, 1, 1), 0), lambda t: refined_edges(t, 0)])
def test_impossible_sizes_are_refused(call: object) -> None:
    with pytest.raises(InputError):
        call(random_tree(1))  # type: ignore[operator]
