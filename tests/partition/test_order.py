"""Visibility order by brute force: random rays must meet the leaves in the order that the tree gives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.errors import InputError
from clusterviz.partition import BspTree, build_tree, front_to_back

BRICK = 8
Vector = tuple[float, float, float]

seeds = st.integers(0, 2**32 - 1)
vectors = st.tuples(*[st.sampled_from([-1.0, -0.3, 0.0, 0.4, 1.0])] * 3)
# Eyes on planes, edges and corners of bricks, anywhere inside, and far away.
positions = st.one_of(st.integers(-1, 6).map(lambda b: float(b * BRICK)), st.floats(-20, 60), st.just(1e7))
eyes = st.tuples(positions, positions, positions)


def random_tree(seed: int) -> BspTree:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 6, 3))
    return build_tree(np.floor(rng.random(shape) * 4), int(rng.integers(1, 24)))


def interval(tree: BspTree, rank: int, start: np.ndarray, direction: np.ndarray) -> tuple[float, float]:
    """The part t ≥ 0 of a ray in a leaf's box, by slabs."""
    box = tree.leaves[rank].box
    if box.bricks == 0:
        return math.inf, -math.inf
    begin, end = (np.array(corner[::-1], float) * BRICK for corner in (box.begin_zyx, box.end_zyx))
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.array([(begin - start) / direction, (end - start) / direction])
    if ((direction == 0) & ((start < begin) | (start > end))).any():
        return math.inf, -math.inf
    crossings = crossings[:, direction != 0]
    return max(0.0, crossings.min(axis=0).max()), crossings.max(axis=0).min()


def visited(tree: BspTree, start: np.ndarray, direction: np.ndarray) -> list[int]:
    """The ranks along a ray, nearest first; leaves that it only touches left out."""
    parts = [(*interval(tree, rank, start, direction), rank) for rank in range(tree.ranks)]
    return [rank for begin, end, rank in sorted(parts) if end - begin > 1e-6 * (1 + abs(begin) * 1e-3)]


def assert_in_order(tree: BspTree, order: list[int], start: np.ndarray, direction: np.ndarray) -> None:
    assert sorted(order) == list(range(tree.ranks))
    along = [order.index(rank) for rank in visited(tree, start, direction)]
    assert along == sorted(along)


@given(seeds, eyes, vectors)
def test_no_ray_from_the_eye_meets_a_later_rank_first(seed: int, eye: Vector, forward: Vector) -> None:
    tree, rng = random_tree(seed), np.random.default_rng(seed + 1)
    order = front_to_back(tree, eye, forward, BRICK)
    size = np.array(tree.shape_zyx[::-1]) * BRICK
    for _ in range(20):
        target = rng.random(3) * size
        assert_in_order(tree, order, np.array(eye), target - eye)


@given(seeds, vectors.filter(any))
def test_no_parallel_ray_meets_a_later_rank_first(seed: int, direction: Vector) -> None:
    tree, rng = random_tree(seed), np.random.default_rng(seed + 1)
    order = front_to_back(tree, None, direction, BRICK)
    size = np.array(tree.shape_zyx[::-1]) * BRICK
    for _ in range(20):
        target = rng.random(3) * size
        assert_in_order(tree, order, target - 100 * np.array(direction), np.array(direction))


def test_the_rays_of_this_test_do_meet_several_leaves() -> None:
    tree = build_tree(np.ones((2, 2, 2)), 8)
    assert visited(tree, np.array([-1.0, 2, 1]), np.array([1.0, 0.6, 0.3])) == [0, 1, 3]
    assert len(visited(tree, np.array([-1.0, -2, -3]), np.array([1.0, 1.1, 1.2]))) == 4


def test_a_row_from_both_ends_and_from_within() -> None:
    tree = build_tree(np.ones((1, 1, 4)), 4)
    assert front_to_back(tree, (-5, 0, 0), (1, 0, 0), BRICK) == [0, 1, 2, 3]
    assert front_to_back(tree, (50, 0, 0), (-1, 0, 0), BRICK) == [3, 2, 1, 0]
    assert front_to_back(tree, (1.5 * BRICK, 0, 0), (1, 0, 0), BRICK) == [1, 0, 2, 3]
    assert front_to_back(tree, None, (1, 0, 0), BRICK) == [0, 1, 2, 3]
    assert front_to_back(tree, None, (-1, 0, 0), BRICK) == [3, 2, 1, 0]


def test_empty_leaves_are_in_the_order_too() -> None:
    assert sorted(front_to_back(build_tree(np.zeros((1, 1, 1)), 7), None, (0, 0, 1), BRICK)) == list(range(7))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_bad_arguments_are_refused(bad: float) -> None:
    tree = build_tree(np.ones((1, 1, 1)), 1)
    for eye, direction, brick in (((bad, 0, 0), (1, 0, 0), 8), (None, (bad, 0, 0), 8), (None, (1, 0, 0), 0)):
        with pytest.raises(InputError):
            front_to_back(tree, eye, direction, brick)
