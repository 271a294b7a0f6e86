"""Visibility order by brute force: random rays must meet bricks, ranks and groups in the order that is given."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clusterviz.partition import (
    UNASSIGNED,
    BrickBox,
    BrickGroup,
    Owners,
    assign_replicas,
    build_tree,
    front_owners,
    front_to_back,
    interleave,
    leaf_pieces,
    owner_pieces,
    owners_of,
    replicate,
    search_tree,
    visible_groups,
)

RAYS = 20
Vector = tuple[float, float, float]

SEEDS = st.integers(0, 2**32 - 1)
DIRECTIONS = st.tuples(*[st.sampled_from([-1.0, -0.3, 0.0, 0.4, 1.0])] * 3)
# On planes, edges and corners of bricks, anywhere inside, and far away.
EYES = st.tuples(*[st.integers(-1, 6).map(float) | st.floats(-2.5, 7.5) | st.just(1e6)] * 3)


def scattered(cost: np.ndarray, ranks: int) -> Owners:
    """Bricks of random ranks, some of nobody; boxes of one rank among them."""
    rng = np.random.default_rng(int(cost.sum()))
    owner = rng.integers(UNASSIGNED, ranks, cost.shape).astype(np.int32)
    z, y, x = (int(n) for n in rng.integers(0, owner.shape))
    owner[z:, :y, x:] = rng.integers(ranks)
    return Owners(ranks, owner)


def replicas(cost: np.ndarray, ranks: int) -> Owners:
    return assign_replicas(replicate(build_tree(cost, ranks), min(1 + int(cost.sum()) % 3, ranks)), cost)


ASSIGNMENTS: dict[str, Callable[[np.ndarray, int], Owners]] = {
    "tree": lambda cost, ranks: owners_of(build_tree(cost, ranks)),
    "searched tree": lambda cost, ranks: owners_of(search_tree(cost, ranks)),
    "fronts": lambda cost, ranks: front_owners(build_tree(cost, ranks), cost, (-3.0, 2.0, 9.0)),
    "interleaved": interleave,
    "replicated": replicas,
    "scattered": scattered,
}


def random_cost(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.floor(rng.random(rng.integers(1, 6, 3)) * 4)


def visited(
    shape_zyx: tuple[int, ...], start: np.ndarray, direction: np.ndarray, forwards: bool
) -> list[tuple[int, ...]]:
    """The bricks along a ray: between two crossings of planes it is in one brick, that of the middle."""
    shape = np.array(shape_zyx[::-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = [(np.arange(n + 1) - s) / d for n, s, d in zip(shape, start, direction, strict=True) if d]
    times = np.unique(np.concatenate([*crossings, [0.0]]))
    times = times[times >= 0] if forwards else times
    # Where a ray only touches an edge, rounding decides which brick its middle is in.
    parts = [(a + b) / 2 for a, b in pairwise(times) if b - a > 1e-9 * (1 + abs(b))]
    places = [np.floor(start + t * direction).astype(int) for t in parts]
    return [tuple(place[::-1].tolist()) for place in places if ((place >= 0) & (place < shape)).all()]


def assert_in_order(number: np.ndarray, eye: Vector | None, direction: Vector, seed: int) -> None:
    """No ray from the eye, or along the direction, meets a later number first; negative ones do not count."""
    rng, size = np.random.default_rng(seed), np.array(number.shape[::-1])
    for _ in range(RAYS):
        target = rng.random(3) * size
        start, along = (target, np.array(direction)) if eye is None else (np.array(eye), target - eye)
        found = [number[brick] for brick in visited(number.shape, start, along, eye is not None) if number[brick] >= 0]
        assert found == sorted(found)


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


@pytest.mark.cover
@pytest.mark.parametrize("name", ASSIGNMENTS)
@settings(max_examples=30)
@given(SEEDS, st.none() | EYES, DIRECTIONS.filter(any), st.integers(1, 9))
def test_no_ray_meets_a_later_group_first(
    name: str, seed: int, eye: Vector | None, direction: Vector, ranks: int
) -> None:
    owners = ASSIGNMENTS[name](random_cost(seed), ranks)
    groups = visible_groups(owners, eye, direction)
    assert_in_order(numbered(owners, groups), eye, direction, seed + 1)
    if name.endswith("tree"):
        assert sorted(group.rank for group in groups) == sorted(set(owners.owner.flat)), "one group a rank"


@given(SEEDS, st.none() | EYES, DIRECTIONS.filter(any), st.integers(1, 23))
def test_no_ray_meets_a_later_leaf_of_a_tree_first(
    seed: int, eye: Vector | None, direction: Vector, ranks: int
) -> None:
    tree = build_tree(random_cost(seed), ranks)
    order = front_to_back(tree, eye, direction)
    assert sorted(order) == list(range(ranks)), "empty leaves, too"
    number = np.full(tree.shape_zyx, -1)
    for place, rank in enumerate(order):
        number[tree.leaves[rank].box.slices] = place
    assert_in_order(number, eye, direction, seed + 1)


def test_the_rays_of_this_test_do_meet_several_bricks() -> None:
    along = visited((2, 2, 2), np.array([-1.0, -2, -3]) / 8, np.array([1.0, 1.1, 1.2]), forwards=True)
    assert along == [(0, 0, 0), (0, 0, 1), (0, 1, 1), (1, 1, 1)]


def test_a_row_from_both_ends_and_from_within() -> None:
    tree = build_tree(np.ones((1, 1, 4)), 4)
    for eye, forward, order in (
        ((-0.6, 0, 0), (1, 0, 0), [0, 1, 2, 3]),
        ((6.2, 0, 0), (-1, 0, 0), [3, 2, 1, 0]),
        ((1.5, 0, 0), (1, 0, 0), [1, 0, 2, 3]),
        (None, (1, 0, 0), [0, 1, 2, 3]),
        (None, (-1, 0, 0), [3, 2, 1, 0]),
    ):
        assert front_to_back(tree, eye, forward) == order


def test_bricks_of_nobody_are_passed_through() -> None:
    owners = Owners(2, np.array([[[0, UNASSIGNED, 0, 1, UNASSIGNED, 0]]], np.int32))
    groups = visible_groups(owners, (-0.6, 0, 0), (1, 0, 0))
    assert [group.bricks[:, 2].tolist() for group in groups] == [[0, 2], [3], [5]]
    assert [group.rank for group in visible_groups(owners, None, (-1, 0, 0))] == [0, 1, 0]
    assert visible_groups(Owners(3, np.full((2, 1, 1), UNASSIGNED, np.int32)), None, (0, 0, 1)) == ()


EYE, FORWARD = (10.0, -2.25, 0.75), (-1.0, 0.2, 0.1)


def test_groups_become_pieces_of_their_bricks() -> None:
    owner = np.random.default_rng(1).integers(-1, 3, (4, 3, 5)).astype(np.int32)
    groups = visible_groups(Owners(3, owner), EYE, FORWARD)
    pieces = owner_pieces(Owners(3, owner), EYE, FORWARD)
    assert [piece.rank for piece in pieces] == [group.rank for group in groups]
    drawn = np.full(owner.shape, UNASSIGNED)
    for piece, group in zip(pieces, groups, strict=True):
        members = piece.members(np.ones(owner.shape, bool))
        np.testing.assert_array_equal(members, group.bricks)
        drawn[tuple(members.T)] = piece.rank
    np.testing.assert_array_equal(drawn, owner)
    # A whole box needs no mask.
    halves = np.arange(8, dtype=np.int32).reshape(2, 2, 2) // 4
    whole = owner_pieces(Owners(2, halves), EYE, FORWARD)
    assert [piece.bricks for piece in whole] == [None, None]
    assert {piece.box for piece in whole} == {BrickBox((0, 0, 0), (1, 2, 2)), BrickBox((1, 0, 0), (2, 2, 2))}


def test_leaves_become_pieces_trimmed_to_what_costs_now() -> None:
    dealt = np.ones((4, 4, 4))
    tree = build_tree(dealt, 3)
    cost = dealt.copy()
    cost[tree.leaves[1].box.slices] = 0
    cost[0, 0, :2] = 0
    pieces = leaf_pieces(tree, cost, EYE, FORWARD)
    assert [piece.rank for piece in pieces] == [rank for rank in front_to_back(tree, EYE, FORWARD) if rank != 1]
    assert sum(len(piece.members(cost > 0)) for piece in pieces) == np.count_nonzero(cost)
