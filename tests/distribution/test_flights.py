"""State of migration: every brick is drawn once and held by its owner, within the memory limit, after any events."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from clusterviz.distribution.flights import (
    Migration,
    Move,
    arrive,
    dispatch,
    hand_over,
    launch,
    settled,
    switch,
    withdraw,
)
from clusterviz.errors import InputError
from clusterviz.partition import Owners, build_tree, owners_of
from clusterviz.partition.tree import Index

SHAPE = (2, 3, 4)
BRICKS: list[Index] = list(product(*map(range, SHAPE)))
RANKS = 3
SIZES = np.arange(24).reshape(SHAPE) % 4 * 10


def moved(migration: Migration, brick: Index, target: int) -> Migration:
    """Planned, sent, arrived and switched."""
    before = launch(migration, [Move(brick, int(migration.owners.owner[brick]), target, 1)])
    before = dispatch(before, [f.brick for f in before.flights if f.stage == "planned"])
    return switch(arrive(before, [f.brick for f in before.flights if f.stage == "sent"]))


class RanksThatSwapBricks(RuleBasedStateMachine):
    """Three ranks with memories of their own, which do what the value says, and forget what it lets them forget."""

    @initialize(room=st.integers(0, 200))
    def begin(self, room: int) -> None:
        owners = owners_of(build_tree(np.ones(SHAPE), RANKS))
        limit = int(owners.loads(SIZES.astype(float)).max()) + room
        self.value = settled(owners, SIZES, limit)
        self.memory = [self.value.holds(rank) for rank in range(RANKS)]
        self.wire: set[tuple[Index, int]] = set()

    def follow(self, value: Migration) -> None:
        self.value = value
        for rank in range(RANKS):
            self.memory[rank] &= value.holds(rank)

    @rule(choices=st.lists(st.tuples(st.sampled_from(BRICKS), st.integers(0, RANKS - 1)), max_size=4))
    def plan(self, choices: list[tuple[Index, int]]) -> None:
        for brick, target in choices:
            source, moving = int(self.value.owners.owner[brick]), self.value.moving
            fits = SIZES[brick] <= self.value.free_bytes[target]
            if source != target and fits and not moving[brick]:
                self.follow(launch(self.value, [Move(brick, source, target, int(SIZES[brick]))]))
            else:
                with pytest.raises(InputError):
                    launch(self.value, [Move(brick, source, target, int(SIZES[brick]))])

    @precondition(lambda self: any(f.stage == "planned" for f in self.value.flights))
    @rule(data=st.data())
    def send(self, data: st.DataObject) -> None:
        flight = data.draw(st.sampled_from([f for f in self.value.flights if f.stage == "planned"]))
        assert flight.brick in self.memory[flight.source]
        self.wire.add((flight.brick, flight.target))
        self.follow(dispatch(self.value, [flight.brick]))

    @precondition(lambda self: any(f.stage == "sent" for f in self.value.flights))
    @rule(data=st.data(), damaged=st.booleans())
    def receive(self, data: st.DataObject, damaged: bool) -> None:
        flight = data.draw(st.sampled_from([f for f in self.value.flights if f.stage == "sent"]))
        self.wire.remove((flight.brick, flight.target))
        if damaged:
            self.follow(withdraw(self.value, [flight.brick]))
            return
        self.memory[flight.target].add(flight.brick)
        self.follow(arrive(self.value, [flight.brick]))

    @rule()
    def hand_over(self) -> None:
        self.follow(switch(self.value))

    @invariant()
    def who_draws_a_brick_has_it(self) -> None:
        if hasattr(self, "value"):
            drawn = [brick for rank in range(RANKS) for brick in map(tuple, self.value.owners.bricks(rank))]
            assert sorted(drawn) == BRICKS
            for brick in BRICKS:
                # Bricks without bytes are everywhere at once.
                assert not SIZES[brick] or brick in self.memory[self.value.owners.owner[brick]]

    @invariant()
    def memory_stays_below_the_limit(self) -> None:
        if hasattr(self, "value"):
            assert (self.value.held_bytes <= self.value.limit_bytes).all()
            for rank in range(RANKS):
                due = sum(int(SIZES[brick]) for brick, target in self.wire if target == rank)
                assert due + sum(int(SIZES[brick]) for brick in self.memory[rank]) <= self.value.limit_bytes

    @invariant()
    def ranks_hold_what_the_value_says(self) -> None:
        if hasattr(self, "value"):
            for rank in range(RANKS):
                said = {brick for brick in self.value.holds(rank) if SIZES[brick]}
                assert said == {brick for brick in self.memory[rank] if SIZES[brick]}


TestRanksThatSwapBricks = RanksThatSwapBricks.TestCase
TestRanksThatSwapBricks.settings = settings(max_examples=25, stateful_step_count=40, deadline=None)


def row(limit: int, each: int = 2) -> Migration:
    """Bricks of 10 bytes in a row, two or more a rank."""
    owner = np.repeat(np.int32([0, 1]), each).reshape(1, 1, -1)
    return settled(Owners(2, owner), np.full(owner.shape, 10), limit)


def owners(migration: Migration) -> list[int]:
    return migration.owners.owner.ravel().tolist()


def test_the_sender_draws_until_the_receiver_has_it() -> None:
    value = launch(row(40), [Move((0, 0, 1), 0, 1, 10)])
    assert owners(value) == [0, 0, 1, 1]
    value = switch(dispatch(value, [(0, 0, 1)]))
    assert owners(value) == [0, 0, 1, 1]
    value = arrive(value, [(0, 0, 1)])
    assert owners(value) == [0, 0, 1, 1]
    assert owners(switch(value)) == [0, 1, 1, 1]


def test_a_brick_that_comes_back_is_not_sent_again() -> None:
    there = moved(row(40), (0, 0, 1), 1)
    assert there.cached == (((0, 0, 1),), ())
    back = launch(there, [Move((0, 0, 1), 1, 0, 0)])
    assert [flight.stage for flight in back.flights] == ["held"]
    assert owners(switch(back)) == [0, 0, 1, 1]
    assert switch(back).cached == ((), ((0, 0, 1),))


def test_the_least_recently_drawn_brick_gives_way() -> None:
    value = moved(moved(row(40), (0, 0, 1), 1), (0, 0, 0), 1)
    assert value.cached[0] == ((0, 0, 1), (0, 0, 0))
    value = moved(moved(value, (0, 0, 2), 0), (0, 0, 3), 0)
    assert value.cached[0] == ((0, 0, 1), (0, 0, 0))
    tight = moved(moved(row(30), (0, 0, 1), 1), (0, 0, 2), 0)
    assert tight.cached == (((0, 0, 1),), ((0, 0, 2),))
    assert moved(tight, (0, 0, 3), 0).cached[0] == ()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: row(19), "≥ 20"),
        *(
            (lambda step=step: step(row(40), [(0, 0, 2)]), r"brick \(0, 0, 2\)")
            for step in (dispatch, arrive, withdraw)
        ),
    ],
)
def test_a_share_above_the_limit_and_bricks_that_are_not_on_their_way_are_refused(
    call: Callable[[], Migration], text: str
) -> None:
    with pytest.raises(InputError, match=text):
        call()


COST = np.ones((1, 1, 8))


def exchange() -> Migration:
    """Two ranks with four bricks each, that shall exchange two."""
    moves = [Move((0, 0, x), 0, 1, 10) for x in (0, 1)] + [Move((0, 0, x), 1, 0, 10) for x in (6, 7)]
    return dispatch(launch(row(1000, 4), moves), [move.brick for move in moves])


def test_half_of_an_exchange_waits_for_the_other() -> None:
    waiting = hand_over(arrive(exchange(), [(0, 0, 0), (0, 0, 1)]), COST)
    assert owners(waiting) == [0] * 4 + [1] * 4
    assert len(waiting.flights) == 4
    whole = hand_over(arrive(waiting, [(0, 0, 6), (0, 0, 7)]), COST)
    assert owners(whole) == [1, 1, 0, 0, 1, 1, 0, 0]
    assert whole.flights == ()


def test_what_evens_the_ranks_out_or_is_alone_waits_for_nothing() -> None:
    cost = COST.copy()
    cost[..., :2] = 3.0
    turned = hand_over(arrive(exchange(), [(0, 0, 0)]), cost)
    assert (owners(turned), len(turned.flights)) == ([1, 0, 0, 0, 1, 1, 1, 1], 3)
    uneven = np.arange(1.0, 9.0).reshape(1, 1, 8)
    flying = dispatch(launch(row(1000, 4), [Move((0, 0, 0), 0, 1, 10)]), [(0, 0, 0)])
    assert owners(hand_over(arrive(flying, [(0, 0, 0)]), uneven)) == [1, 0, 0, 0, 1, 1, 1, 1]
