"""Pieces: every brick that is shown in exactly one, in the order of the groups that they were made of."""

from __future__ import annotations

import numpy as np

from clusterviz.partition import (
    UNASSIGNED,
    BrickBox,
    Owners,
    build_tree,
    front_to_back,
    group_pieces,
    leaf_pieces,
    visible_groups,
)

EYE, FORWARD, BRICK = (40.0, -9.0, 3.0), (-1.0, 0.2, 0.1), 4


def test_groups_become_pieces_of_their_bricks() -> None:
    owner = np.random.default_rng(1).integers(-1, 3, (4, 3, 5)).astype(np.int32)
    groups = visible_groups(Owners(3, owner), EYE, FORWARD, BRICK)
    pieces = group_pieces(groups)
    assert [piece.rank for piece in pieces] == [group.rank for group in groups]
    drawn = np.full(owner.shape, UNASSIGNED)
    for piece, group in zip(pieces, groups, strict=True):
        members = piece.members(np.ones(owner.shape, bool))
        np.testing.assert_array_equal(members, group.bricks)
        drawn[tuple(members.T)] = piece.rank
    np.testing.assert_array_equal(drawn, owner)


def test_leaves_become_pieces_trimmed_to_what_costs_now() -> None:
    dealt = np.ones((4, 4, 4))
    tree = build_tree(dealt, 3)
    cost = dealt.copy()
    cost[tree.leaves[1].box.slices] = 0
    cost[0, 0, :2] = 0
    pieces = leaf_pieces(tree, cost, EYE, FORWARD, BRICK)
    order = [rank for rank in front_to_back(tree, EYE, FORWARD, BRICK) if rank != 1]
    assert [piece.rank for piece in pieces] == order
    assert sum(len(piece.members(cost > 0)) for piece in pieces) == np.count_nonzero(cost)


def test_a_whole_box_needs_no_mask() -> None:
    owner = np.zeros((2, 2, 2), np.int32)
    owner[1] = 1
    pieces = group_pieces(visible_groups(Owners(2, owner), EYE, FORWARD, BRICK))
    assert [piece.bricks for piece in pieces] == [None, None]
    assert {piece.box for piece in pieces} == {BrickBox((0, 0, 0), (1, 2, 2)), BrickBox((1, 0, 0), (2, 2, 2))}
