"""Bricks between ranks, as a value: who draws each brick, what is in flight, and what is cached.

A rank hands over a brick that has arrived only if the receiver does not become the busiest rank by it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.distribution.rebalance import Move
from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import Owners
from clusterviz.partition.tree import Index

Stage = Literal["planned", "sent", "held"]


@dataclass(frozen=True)
class Flight:
    """A brick that changes hands."""

    brick: Index
    source: int
    target: int
    stage: Stage


@dataclass(frozen=True, eq=False)
class Migration:
    """What every rank holds.

    Attributes
    ----------
    owners : who draws what
    brick_bytes : int64 (bz, by, bx), what holding a brick takes; 0 for those that need not be held
    limit_bytes : of bricks a rank
    flights : what is on its way, oldest first
    cached : for each rank the bricks that it holds beside those it draws, the least recently drawn first
    """

    owners: Owners
    brick_bytes: NDArray[np.int64]
    limit_bytes: int
    flights: tuple[Flight, ...] = ()
    cached: tuple[tuple[Index, ...], ...] = ()

    @property
    def moving(self) -> NDArray[np.bool_]:
        """The bricks in flight, bool (bz, by, bx)."""
        found = np.zeros(self.brick_bytes.shape, bool)
        for flight in self.flights:
            found[flight.brick] = True
        return found

    @property
    def landed(self) -> Owners:
        """Who will draw what once everything has arrived."""
        owner = self.owners.owner.copy()
        for flight in self.flights:
            owner[flight.brick] = flight.target
        return Owners(self.owners.ranks, owner)

    @property
    def pinned_bytes(self) -> NDArray[np.int64]:
        """What each rank draws and awaits, int64 (ranks,)."""
        held = self.owners.sums(self.brick_bytes)
        for flight in self.flights:
            held[flight.target] += self.brick_bytes[flight.brick]
        return held

    @property
    def held_bytes(self) -> NDArray[np.int64]:
        """What each rank draws, awaits and caches; never above the limit, int64 (ranks,)."""
        return self.pinned_bytes + np.array([self._sum(bricks) for bricks in self.cached], np.int64)

    @property
    def free_bytes(self) -> NDArray[np.int64]:
        """What each rank can give to further bricks, if it gives up its cache; int64 (ranks,)."""
        return self.limit_bytes - self.pinned_bytes

    def holds(self, rank: int) -> set[Index]:
        """The bricks whose voxels a rank has: what it draws, has received and caches. It may drop all others."""
        drawn = {(int(z), int(y), int(x)) for z, y, x in self.owners.bricks(rank)}
        received = {flight.brick for flight in self.flights if flight.target == rank and flight.stage == "held"}
        return drawn | received | set(self.cached[rank])

    def _sum(self, bricks: Iterable[Index]) -> int:
        return sum(int(self.brick_bytes[brick]) for brick in bricks)


def settled(owners: Owners, brick_bytes: NDArray[np.int64], limit_bytes: int) -> Migration:
    """Nothing in flight, nothing cached.

    Raises
    ------
    InputError
        A rank's share is above the limit; `check_memory` says so in terms of ranks.
    """
    start = Migration(owners, brick_bytes, limit_bytes, (), ((),) * owners.ranks)
    most = int(start.held_bytes.max())
    if most > limit_bytes:
        raise InputError("a rank's bricks do not fit", where="memory limit", found=limit_bytes, allowed=f"≥ {most}")
    return start


def launch(migration: Migration, moves: Iterable[Move]) -> Migration:
    """Plan moves: room is made for them, the oldest of the caches giving way. What is cached at its target has arrived.

    Raises
    ------
    InputError
        A brick is in flight already, is not its source's, or does not fit beside what its target draws and awaits.
    """
    moves = tuple(moves)
    busy = {flight.brick for flight in migration.flights}
    free = migration.free_bytes
    cached = [dict.fromkeys(bricks) for bricks in migration.cached]
    flights = list(migration.flights)
    for move in moves:
        if move.brick in busy or migration.owners.owner[move.brick] != move.source or move.source == move.target:
            raise InputError("cannot move", where=f"brick {move.brick}", found=f"{move.source} → {move.target}")
        free[move.target] -= migration.brick_bytes[move.brick]
        if free[move.target] < 0:
            raise InputError("does not fit", where=f"brick {move.brick}", found=f"rank {move.target}")
        busy.add(move.brick)
        kept = move.brick in cached[move.target] or not migration.brick_bytes[move.brick]
        cached[move.target].pop(move.brick, None)
        flights.append(Flight(move.brick, move.source, move.target, "held" if kept else "planned"))
    remains = tuple(_shrunk(migration, bricks, int(room)) for bricks, room in zip(cached, free, strict=True))
    return replace(migration, flights=tuple(flights), cached=remains)


def dispatch(migration: Migration, bricks: Collection[Index]) -> Migration:
    """Messages with these planned bricks have been posted."""
    return _staged(migration, bricks, "planned", "sent")


def arrive(migration: Migration, bricks: Collection[Index]) -> Migration:
    """These sent bricks are whole at their targets, and all ranks know."""
    return _staged(migration, bricks, "sent", "held")


def withdraw(migration: Migration, bricks: Collection[Index]) -> Migration:
    """These bricks will not arrive: a damaged message, a changed mind. Their senders draw on.

    Raises
    ------
    InputError
        One of them is not in flight.
    """
    _check(migration, bricks, {flight.brick for flight in migration.flights}, "in flight")
    return replace(migration, flights=tuple(flight for flight in migration.flights if flight.brick not in bricks))


def switch(migration: Migration, bricks: Collection[Index] | None = None) -> Migration:
    """From now on the targets of bricks that have arrived draw them; their senders keep them in their caches.

    Parameters
    ----------
    bricks : which; all that have arrived where None

    Raises
    ------
    InputError
        One of them has not arrived.
    """
    held = {flight.brick for flight in migration.flights if flight.stage == "held"}
    turned = held if bricks is None else set(bricks)
    _check(migration, turned, held, "held")
    owner = migration.owners.owner.copy()
    cached = [list(bricks) for bricks in migration.cached]
    for flight in migration.flights:
        if flight.brick in turned:
            owner[flight.brick] = flight.target
            if migration.brick_bytes[flight.brick]:
                cached[flight.source].append(flight.brick)
    return replace(
        migration,
        owners=Owners(migration.owners.ranks, owner),
        flights=tuple(flight for flight in migration.flights if flight.brick not in turned),
        cached=tuple(map(tuple, cached)),
    )


def forget(migration: Migration) -> Migration:
    """All caches empty: the voxels have changed."""
    return replace(migration, cached=((),) * migration.owners.ranks)


def _shrunk(migration: Migration, bricks: dict[Index, None], room: int) -> tuple[Index, ...]:
    """A cache without its oldest, so that it fits into a room."""
    taken = sum(int(migration.brick_bytes[brick]) for brick in bricks)
    remains = list(bricks)
    begin = 0
    while taken > room:
        taken -= int(migration.brick_bytes[remains[begin]])
        begin += 1
    return tuple(remains[begin:])


def _staged(migration: Migration, bricks: Collection[Index], old: Stage, new: Stage) -> Migration:
    wanted = set(bricks)
    _check(migration, wanted, {flight.brick for flight in migration.flights if flight.stage == old}, old)
    flights = tuple(replace(f, stage=new) if f.brick in wanted else f for f in migration.flights)
    return replace(migration, flights=flights)


def _check(migration: Migration, bricks: Collection[Index], known: set[Index], stage: str) -> None:
    if strange := sorted(set(bricks) - known):
        raise InputError(f"not {stage}", where=f"brick {strange[0]}", found=f"{len(migration.flights)} in flight")


UNEVEN = 1.02  # busiest over mean, up to which bricks change hands whoever has more then


def hand_over(migration: Migration, cost: Costs) -> Migration:
    """As many of the bricks that have arrived, the oldest flights first, as leave the busiest rank with no more.

    Parameters
    ----------
    migration : before a frame
    cost : float64 (bz, by, bx), expected in that frame

    Returns
    -------
    migration : all have changed hands if nothing else is in flight, so none waits for ever
    """
    held = [flight for flight in migration.flights if flight.stage == "held"]
    if len(held) == len(migration.flights):
        return switch(migration)
    loads = migration.owners.loads(cost)
    limit, count = max(float(loads.max()), UNEVEN * float(loads.mean())), 0
    for number, flight in enumerate(held, start=1):
        loads[flight.source] -= cost[flight.brick]
        loads[flight.target] += cost[flight.brick]
        if loads.max() <= limit:
            count = number
    return switch(migration, [flight.brick for flight in held[:count]])
