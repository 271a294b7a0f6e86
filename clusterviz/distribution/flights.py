"""State of migration: the owner of each brick, bricks in flight, and cached bricks.

A brick that has arrived is handed over only if its receiver does not become the busiest rank by it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import Owners
from clusterviz.partition.tree import Index

Stage = Literal["planned", "sent", "held"]


@dataclass(frozen=True)
class Move:
    """Planned move of a brick; `wire_bytes` is 0 if the target has it already."""

    brick: Index
    source: int
    target: int
    wire_bytes: int


@dataclass(frozen=True)
class Flight:
    """Brick on its way from one rank to another."""

    brick: Index
    source: int
    target: int
    stage: Stage


@dataclass(frozen=True, eq=False)
class Migration:
    """Bricks of every rank, and bricks in flight."""

    owners: Owners  # that draw each brick
    # int64 (bz, by, bx), size of each brick in memory; 0 for those that need not be held
    brick_bytes: NDArray[np.int64]
    limit_bytes: int  # of bricks that a rank may hold
    flights: tuple[Flight, ...] = ()  # bricks on their way, oldest first
    # for each rank the bricks that it holds but does not draw, the least recently drawn first
    cached: tuple[tuple[Index, ...], ...] = ()

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Bricks in flight, bool (bz, by, bx)."""
        moving = np.zeros(self.brick_bytes.shape, bool)
        for flight in self.flights:
            moving[flight.brick] = True
        return moving

    @property
    def landed(self) -> Owners:
        """Owners after all flights."""
        owner = self.owners.owner.copy()
        for flight in self.flights:
            owner[flight.brick] = flight.target
        return Owners(self.owners.ranks, owner)

    @property
    def pinned_bytes(self) -> NDArray[np.int64]:
        """Bytes of the bricks that each rank draws or awaits, int64 (ranks,)."""
        held = self.owners.sums(self.brick_bytes)
        for flight in self.flights:
            held[flight.target] += self.brick_bytes[flight.brick]
        return held

    @property
    def held_bytes(self) -> NDArray[np.int64]:
        """Bytes of the bricks that each rank draws, awaits or caches, int64 (ranks,); never above the limit."""
        return self.pinned_bytes + np.array([self._sum(bricks) for bricks in self.cached], np.int64)

    @property
    def free_bytes(self) -> NDArray[np.int64]:
        """Bytes that each rank has for further bricks if it empties its cache, int64 (ranks,)."""
        return self.limit_bytes - self.pinned_bytes

    def holds(self, rank: int) -> set[Index]:
        """Return the bricks that a rank draws, has received or caches; it may drop all others."""
        drawn = {(int(z), int(y), int(x)) for z, y, x in self.owners.bricks(rank)}
        received = {flight.brick for flight in self.flights if flight.target == rank and flight.stage == "held"}
        return drawn | received | set(self.cached[rank])

    def _sum(self, bricks: Iterable[Index]) -> int:
        return sum(int(self.brick_bytes[brick]) for brick in bricks)


def settled(owners: Owners, brick_bytes: NDArray[np.int64], limit_bytes: int) -> Migration:
    """Return a state without flights and with empty caches.

    Raises InputError if a rank's bricks exceed the limit; `check_memory` gives a message in terms of ranks.
    """
    start = Migration(owners, brick_bytes, limit_bytes, (), ((),) * owners.ranks)
    most = int(start.held_bytes.max())
    if most > limit_bytes:
        raise InputError("a rank's bricks do not fit", where="memory limit", found=limit_bytes, allowed=f"≥ {most}")
    return start


def launch(migration: Migration, moves: Iterable[Move]) -> Migration:
    """Plan moves; the oldest bricks of caches are dropped for them. A brick that its target caches has arrived.

    Raises InputError if a brick is in flight already, its source does not own it, or it does not fit into its
    target's memory.
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
    shrunk = tuple(_shrunk(migration, bricks, int(left)) for bricks, left in zip(cached, free, strict=True))
    return replace(migration, flights=tuple(flights), cached=shrunk)


def dispatch(migration: Migration, bricks: Collection[Index]) -> Migration:
    """Record that planned bricks have been sent."""
    return _staged(migration, bricks, "planned", "sent")


def arrive(migration: Migration, bricks: Collection[Index]) -> Migration:
    """Record that sent bricks are complete at their targets, which all ranks know."""
    return _staged(migration, bricks, "sent", "held")


def withdraw(migration: Migration, bricks: Collection[Index]) -> Migration:
    """Cancel the flights of bricks, after a damaged message for example; their senders still draw them.

    Raises InputError if one of them is not in flight.
    """
    _check(migration, bricks, {flight.brick for flight in migration.flights}, "in flight")
    return replace(migration, flights=tuple(flight for flight in migration.flights if flight.brick not in bricks))


def switch(migration: Migration, bricks: Collection[Index] | None = None) -> Migration:
    """Hand over bricks that have arrived to their targets; their senders keep them in their caches.

    `bricks`: to hand over; None: all that have arrived. Raises InputError if one of them has not arrived.
    """
    held = {flight.brick for flight in migration.flights if flight.stage == "held"}
    switched = held if bricks is None else set(bricks)
    _check(migration, switched, held, "held")
    owner = migration.owners.owner.copy()
    cached = [list(bricks) for bricks in migration.cached]
    for flight in migration.flights:
        if flight.brick in switched:
            owner[flight.brick] = flight.target
            if migration.brick_bytes[flight.brick]:
                cached[flight.source].append(flight.brick)
    return replace(
        migration,
        owners=Owners(migration.owners.ranks, owner),
        flights=tuple(flight for flight in migration.flights if flight.brick not in switched),
        cached=tuple(map(tuple, cached)),
    )


def _shrunk(migration: Migration, bricks: dict[Index, None], limit_bytes: int) -> tuple[Index, ...]:
    """Drop the oldest bricks of a cache until it fits into a limit."""
    size = sum(int(migration.brick_bytes[brick]) for brick in bricks)
    cached = list(bricks)
    begin = 0
    while size > limit_bytes:
        size -= int(migration.brick_bytes[cached[begin]])
        begin += 1
    return tuple(cached[begin:])


def _staged(migration: Migration, bricks: Collection[Index], old: Stage, new: Stage) -> Migration:
    wanted = set(bricks)
    _check(migration, wanted, {flight.brick for flight in migration.flights if flight.stage == old}, old)
    flights = tuple(replace(f, stage=new) if f.brick in wanted else f for f in migration.flights)
    return replace(migration, flights=flights)


def _check(migration: Migration, bricks: Collection[Index], known: set[Index], stage: str) -> None:
    if unknown := sorted(set(bricks) - known):
        raise InputError(f"not {stage}", where=f"brick {unknown[0]}", found=f"{len(migration.flights)} in flight")


UNEVEN = 1.02  # imbalance up to which bricks are handed over in any case


def hand_over(migration: Migration, cost: Costs) -> Migration:
    """Hand over arrived bricks, the oldest flights first, as many as do not raise the cost of the busiest rank.

    All bricks are handed over if no other flight is under way, so that none waits forever.

    Parameters
    ----------
    migration : before a frame
    cost : float64 (bz, by, bx), expected in that frame
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
