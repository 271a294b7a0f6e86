"""Visibility order of any assignment by brute force: random rays must meet the groups in their order."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.errors import InputError
from clusterviz.partition import (
    UNASSIGNED,
    BrickGroup,
    Owners,
    assign_replicas,
    build_tree,
    interleave,
    owners_of,
    ranks_of,
    replicate,
    visible_groups,
)

BRICK = 8
RAYS = 20
Vector = tuple[float, float, float]

seeds = st.integers(0, 2**32 - 1)
vectors = st.tuples(*[st.sampled_from([-1.0, -0.3, 0.0, 0.4, 1.0])] * 3)
# Eyes on planes, edges and corners of bricks, anywhere inside, and far away.
positions = st.one_of(st.integers(-1, 6).map(lambda b: float(b * BRICK)), st.floats(-20, 60), st.just(1e6))
eyes = st.tuples(positions, positions, positions)


def scattered(seed: int) -> Owners:
    """Bricks of random ranks, some of nobody; boxes of one rank among them."""
    rng = np.random.default_rng(seed)
    ranks = int(rng.integers(1, 6))
    owner = rng.integers(UNASSIGNED, ranks, rng.integers(1, 6, 3)).astype(np.int32)
    z, y, x = (int(n) for n in rng.integers(0, owner.shape))
    owner[z:, :y, x:] = rng.integers(ranks)
    return Owners(ranks, owner)


def visited(owners: Owners, start: np.ndarray, direction: np.ndarray, forwards: bool) -> list[tuple[int, ...]]:
    """The bricks along a ray: between two crossings of planes it is in one brick, that of the middle."""
    shape = np.array(owners.owner.shape[::-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = [(np.arange(n + 1) * BRICK - s) / d for n, s, d in zip(shape, start, direction, strict=True) if d]
    times = np.unique(np.concatenate([*crossings, [0.0]]))
    times = times[times >= 0] if forwards else times
    # Where a ray only touches an edge, rounding decides which brick its middle is in.
    parts = [(a + b) / 2 for a, b in pairwise(times) if b - a > 1e-9 * (1 + abs(b))]
    places = [np.floor((start + t * direction) / BRICK).astype(int) for t in parts]
    return [tuple(place[::-1].tolist()) for place in places if ((place >= 0) & (place < shape)).all()]


def numbered(owners: Owners, groups: tuple[BrickGroup, ...]) -> np.ndarray:
    """Each brick's group; every drawn brick in exactly one, of its owner."""
    number = np.full(owners.owner.shape, -1)
    for index, group in enumerate(groups):
        at = tuple(group.bricks.T)
        assert len(group.bricks)
        assert (number[at] == -1).all()
        assert (owners.owner[at] == group.rank).all()
        number[at] = index
    assert ((number >= 0) == (owners.owner != UNASSIGNED)).all()
    return number


def assert_in_order(number: np.ndarray, bricks: list[tuple[int, ...]]) -> None:
    along = [number[brick] for brick in bricks if number[brick] >= 0]
    assert along == sorted(along)


@given(seeds, eyes, vectors)
def test_no_ray_from_the_eye_meets_a_later_group_first(seed: int, eye: Vector, forward: Vector) -> None:
    owners, rng = scattered(seed), np.random.default_rng(seed + 1)
    number = numbered(owners, visible_groups(owners, eye, forward, BRICK))
    size = np.array(owners.owner.shape[::-1]) * BRICK
    for _ in range(RAYS):
        assert_in_order(number, visited(owners, np.array(eye), rng.random(3) * size - eye, forwards=True))


@given(seeds, vectors.filter(any))
def test_no_parallel_ray_meets_a_later_group_first(seed: int, direction: Vector) -> None:
    owners, rng = scattered(seed), np.random.default_rng(seed + 1)
    number = numbered(owners, visible_groups(owners, None, direction, BRICK))
    size = np.array(owners.owner.shape[::-1]) * BRICK
    for _ in range(RAYS):
        assert_in_order(number, visited(owners, rng.random(3) * size, np.array(direction), forwards=False))


def test_the_rays_of_this_test_do_meet_several_bricks() -> None:
    owners = Owners(1, np.zeros((2, 2, 2), np.int32))
    along = visited(owners, np.array([-1.0, -2, -3]), np.array([1.0, 1.1, 1.2]), forwards=True)
    assert along == [(0, 0, 0), (0, 0, 1), (0, 1, 1), (1, 1, 1)]


@given(seeds, eyes, st.integers(1, 9))
def test_a_tree_takes_one_group_a_rank(seed: int, eye: Vector, ranks: int) -> None:
    rng = np.random.default_rng(seed)
    owners = owners_of(build_tree(rng.random(rng.integers(1, 6, 3)), ranks))
    order = ranks_of(visible_groups(owners, eye, (1, 0, 0), BRICK))
    assert sorted(order) == sorted(set(owners.owner.flat))


@settings(max_examples=30)
@given(seeds, eyes, st.integers(1, 7), st.integers(1, 3))
def test_distributions_that_are_no_tree_are_in_order_too(seed: int, eye: Vector, ranks: int, copies: int) -> None:
    rng = np.random.default_rng(seed)
    cost = np.floor(rng.random(rng.integers(1, 6, 3)) * 4)
    size = np.array(cost.shape[::-1]) * BRICK
    home = build_tree(cost, ranks)
    for owners in (interleave(cost, ranks), assign_replicas(replicate(home, min(copies, ranks)), cost)):
        number = numbered(owners, visible_groups(owners, eye, (0, 0, 1), BRICK))
        for _ in range(RAYS):
            assert_in_order(number, visited(owners, np.array(eye), rng.random(3) * size - eye, forwards=True))


def test_bricks_of_nobody_are_passed_through() -> None:
    owners = Owners(2, np.array([[[0, UNASSIGNED, 0, 1, UNASSIGNED, 0]]], np.int32))
    groups = visible_groups(owners, (-5, 0, 0), (1, 0, 0), BRICK)
    assert [group.bricks[:, 2].tolist() for group in groups] == [[0, 2], [3], [5]]
    assert ranks_of(visible_groups(owners, None, (-1, 0, 0), BRICK)) == [0, 1, 0]


def test_nothing_to_draw_is_no_group() -> None:
    assert visible_groups(Owners(3, np.full((2, 1, 1), UNASSIGNED, np.int32)), None, (0, 0, 1), BRICK) == ()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_bad_arguments_are_refused(bad: float) -> None:
    owners = Owners(1, np.zeros((1, 1, 1), np.int32))
    for eye, direction, brick in (((bad, 0, 0), (1, 0, 0), 8), (None, (bad, 0, 0), 8), (None, (1, 0, 0), 0)):
        with pytest.raises(InputError):
            visible_groups(owners, eye, direction, brick)
