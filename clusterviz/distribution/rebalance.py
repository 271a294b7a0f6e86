"""Which bricks change hands in this frame: the second half of balancing, pure, and the same on every rank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import UNASSIGNED, Owners
from clusterviz.partition.tree import Index


@dataclass(frozen=True)
class Move:
    """A brick that shall change hands; `wire_bytes` is 0 where the target has it already."""

    brick: Index
    source: int
    target: int
    wire_bytes: int


@dataclass(frozen=True, eq=False)
class Goal:
    """Where bricks should be, and what it takes.

    Attributes
    ----------
    target : who should draw what; bricks that are nobody's here or in the present stay as they are
    cost : float64 (bz, by, bx), expected
    wire_bytes : int64 (bz, by, bx): what sending each brick to its target takes, 0 where that has it
    held_bytes : int64 (bz, by, bx): the memory that it takes there
    unit : int64 (bz, by, bx), as of `units`: bricks with the same number move together if they go the same way
    """

    target: Owners
    cost: Costs
    wire_bytes: NDArray[np.int64]
    held_bytes: NDArray[np.int64]
    unit: NDArray[np.int64]


def rebalance(
    present: Owners,
    goal: Goal,
    free_bytes: NDArray[np.int64],
    budget_bytes: int,
    moving: NDArray[np.bool_] | None = None,
) -> tuple[Move, ...]:
    """The moves of one frame, of most gain a byte first.

    Gain is the fall of the sum of squares of the ranks' costs. A unit goes before another if it gains more a byte with
    all moves before it made; moves that gain nothing now, but must be made for others to gain later, come last.

    Parameters
    ----------
    present : who draws what once all bricks in flight have landed
    wish : where bricks should be
    free_bytes : int64 (ranks,): memory that each rank can still give to bricks
    budget_bytes : that all ranks together may send in a frame; 0: nothing now, only what targets have already goes
    moving : bool (bz, by, bx), bricks that must stay where they are, as they are in flight

    Returns
    -------
    moves : each brick at most once; at most `budget_bytes` on the wire, at most `free_bytes` into each rank. Made all
        or in part they leave every brick with one rank. Empty where everything is as wished, or nothing fits

    Raises
    ------
    InputError
        The budget cannot carry a single brick of those that should move, so nothing would ever move.
    """
    goes = (present.owner != goal.target.owner) & (present.owner != UNASSIGNED) & (goal.target.owner != UNASSIGNED)
    bricks = np.argwhere(goes & ~moving if moving is not None else goes)
    if len(bricks) == 0:
        return ()
    at = tuple(bricks.T)
    smallest = int(goal.wire_bytes[at].min())
    if smallest > budget_bytes > 0:
        raise InputError("cannot carry one brick", where="budget", found=budget_bytes, allowed=f"{smallest} bytes")
    batches = _batches(present, goal, bricks, budget_bytes)
    chosen = _choose(batches, present.loads(goal.cost), free_bytes, budget_bytes)
    return tuple(
        Move(
            (int(z), int(y), int(x)),
            int(present.owner[z, y, x]),
            int(goal.target.owner[z, y, x]),
            int(goal.wire_bytes[z, y, x]),
        )
        for z, y, x in bricks[_of_batches(batches, chosen)]
    )


def _of_batches(batches: _Batches, chosen: list[int]) -> NDArray[np.int64]:
    """The bricks of parcels, those of the first before those of the second."""
    turn = np.full(len(batches.cost), len(chosen))
    turn[chosen] = np.arange(len(chosen))
    by_turn = np.argsort(turn[batches.members], kind="stable")
    return by_turn[: int(np.count_nonzero(turn[batches.members] < len(chosen)))]


@dataclass(frozen=True, eq=False)
class _Batches:
    """Units by their way: `members` is the parcel of each brick; all else is a number a parcel."""

    members: NDArray[np.int64]
    source: NDArray[np.int64]
    target: NDArray[np.int64]
    cost: NDArray[np.float64]
    wire: NDArray[np.int64]
    held: NDArray[np.int64]


def _batches(present: Owners, goal: Goal, bricks: NDArray[np.int64], budget_bytes: int) -> _Batches:
    at = tuple(bricks.T)
    source, target = present.owner[at].astype(np.int64), goal.target.owner[at].astype(np.int64)
    way = (goal.unit[at] * present.ranks + source) * present.ranks + target
    _, first, members = np.unique(way, return_index=True, return_inverse=True)
    members = members.reshape(-1)
    wire = np.bincount(members, goal.wire_bytes[at]).astype(np.int64)
    if (wire > budget_bytes).any():
        # A unit that no frame can carry goes brick by brick.
        alone = (wire > budget_bytes)[members]
        _, first, members = np.unique(
            np.where(alone, len(first) + np.arange(len(bricks)), members), return_index=True, return_inverse=True
        )
        members = members.reshape(-1)
        wire = np.bincount(members, goal.wire_bytes[at]).astype(np.int64)
    held = np.bincount(members, goal.held_bytes[at]).astype(np.int64)
    return _Batches(
        members, source[first], target[first], np.asarray(np.bincount(members, goal.cost[at]), np.float64), wire, held
    )


def _choose(
    batches: _Batches, loads: NDArray[np.float64], free_bytes: NDArray[np.int64], budget_bytes: int
) -> list[int]:
    """The parcels that go, in order: the best of those that are first in the queue of their way."""
    loads, free = loads.copy(), free_bytes.copy()
    wire = np.maximum(batches.wire, 1)
    way = batches.source * len(loads) + batches.target
    queue = np.lexsort((-batches.cost / wire, way))
    heads = np.flatnonzero(np.diff(way[queue], prepend=-1))
    ends = np.append(heads[1:], len(queue))
    chosen: list[int] = []
    while len(heads):
        first = queue[heads]
        fits = (batches.wire[first] <= budget_bytes) & (batches.held[first] <= free[batches.target[first]])
        heads = heads + ~fits
        if fits.any():
            source, target, cost = batches.source[first], batches.target[first], batches.cost[first]
            gain = cost * (loads[source] - loads[target] - cost)
            # What must be made without a gain comes last, the least loss first.
            a_byte = np.where(gain > 0, gain / wire[first], gain)
            best = int(np.argmax(np.where(fits, a_byte, -np.inf)))
            chosen.append(int(first[best]))
            heads[best] += 1
            loads[source[best]] -= cost[best]
            loads[target[best]] += cost[best]
            free[target[best]] -= batches.held[first[best]]
            budget_bytes -= int(batches.wire[first[best]])
        waiting = heads < ends
        heads, ends = heads[waiting], ends[waiting]
    return chosen
