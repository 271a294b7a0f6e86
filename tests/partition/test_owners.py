"""Owners: loads and imbalance, and what is no assignment."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.errors import InputError
from clusterviz.partition import UNASSIGNED, Owners, bricks_of, build_tree, owners_of


def test_loads_count_each_drawn_brick_once() -> None:
    owners = Owners(3, np.array([[[0, 1, UNASSIGNED, 0]]], np.int32))
    cost = np.array([[[1.0, 2.0, 50.0, 4.0]]])
    assert owners.loads(cost).tolist() == [5, 2, 0]
    assert owners.imbalance(cost) == pytest.approx(5 / (7 / 3))
    assert owners.bricks(0).tolist() == [[0, 0, 0], [0, 0, 3]]


def test_nothing_that_costs_is_balanced() -> None:
    assert Owners(2, np.zeros((1, 1, 2), np.int32)).imbalance(np.zeros((1, 1, 2))) == 1


def test_a_tree_owns_what_its_leaves_hold() -> None:
    cost = np.random.default_rng(3).random((3, 4, 5))
    tree = build_tree(cost, 5)
    owners = owners_of(tree)
    for rank in range(5):
        assert owners.bricks(rank).tolist() == bricks_of(tree, rank, cost).tolist()


@pytest.mark.parametrize(
    "owner", [np.full((1, 1, 1), 2), np.full((1, 1, 1), -2), np.zeros((2, 2)), np.zeros((0, 1, 1))]
)
def test_no_assignment_is_refused(owner: np.ndarray) -> None:
    with pytest.raises(InputError):
        Owners(2, owner.astype(np.int32))
