"""Handing over bricks that have arrived."""

from __future__ import annotations

import numpy as np

from clusterviz.distribution.flights import Migration, Move, arrive, dispatch, hand_over, launch, settled
from clusterviz.partition import Owners

COST = np.ones((1, 1, 8))


def exchange() -> Migration:
    """Two ranks with four bricks each, that shall exchange two."""
    start = settled(Owners(2, np.array([[[0] * 4 + [1] * 4]], np.int32)), np.full((1, 1, 8), 10), 1000)
    moves = [Move((0, 0, x), 0, 1, 10) for x in (0, 1)] + [Move((0, 0, x), 1, 0, 10) for x in (6, 7)]
    flying = launch(start, moves)
    return dispatch(flying, [move.brick for move in moves])


def owners(migration: Migration) -> list[int]:
    return migration.owners.owner.ravel().tolist()


def test_half_of_an_exchange_waits_for_the_other() -> None:
    half = arrive(exchange(), [(0, 0, 0), (0, 0, 1)])
    waiting = hand_over(half, COST)
    assert owners(waiting) == [0] * 4 + [1] * 4
    assert len(waiting.flights) == 4
    whole = hand_over(arrive(waiting, [(0, 0, 6), (0, 0, 7)]), COST)
    assert owners(whole) == [1, 1, 0, 0, 1, 1, 0, 0]
    assert whole.flights == ()


def test_what_evens_the_ranks_out_waits_for_nothing() -> None:
    cost = COST.copy()
    cost[..., :2] = 3.0
    turned = hand_over(arrive(exchange(), [(0, 0, 0)]), cost)
    assert owners(turned) == [1, 0, 0, 0, 1, 1, 1, 1]
    assert len(turned.flights) == 3


def test_nothing_waits_for_what_is_not_in_flight() -> None:
    uneven = np.arange(1.0, 9.0).reshape(1, 1, 8)
    start = settled(Owners(2, np.array([[[0] * 4 + [1] * 4]], np.int32)), np.full((1, 1, 8), 10), 1000)
    flying = dispatch(launch(start, [Move((0, 0, 0), 0, 1, 10)]), [(0, 0, 0)])
    assert owners(hand_over(arrive(flying, [(0, 0, 0)]), uneven)) == [1, 0, 0, 0, 1, 1, 1, 1]
