"""Choice of the bricks that move in a frame: a pure function, the same on every rank."""

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
    """Planned move of a brick; `wire_bytes` is 0 if the target has it already."""

    brick: Index
    source: int
    target: int
    wire_bytes: int


@dataclass(frozen=True, eq=False)
class Goal:
    """Wanted owners of the bricks, with costs and sizes.

    Attributes
    ----------
    target : wanted owners; bricks without an owner, here or at present, stay
    cost : float64 (bz, by, bx), expected cost
    wire_bytes : int64 (bz, by, bx), size in a message to the target; 0 if the target has the brick
    held_bytes : int64 (bz, by, bx), size in the target's memory
    unit : int64 (bz, by, bx), as `units` returns it: bricks of a unit with the same source and target move together
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
    """Choose the moves of one frame, by gain a byte.

    The gain of a move is the decrease of the sum of squares of the ranks' costs, after all moves chosen before it.
    Moves without a gain, which may enable others later, come last.

    Parameters
    ----------
    present : owners after all flights
    goal : wanted owners
    free_bytes : int64 (ranks,), free memory of each rank
    budget_bytes : that all ranks together may send in a frame; 0: only bricks that their targets have already
    moving : bool (bz, by, bx), bricks in flight, which must not move

    Returns
    -------
    moves : each brick at most once, at most `budget_bytes` in all messages and `free_bytes` into each rank; empty if
        the goal is reached or nothing fits

    Raises
    ------
    InputError
        The budget is smaller than every brick that should move, so nothing would ever move.
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
    """Return the bricks of the chosen batches, in the order of these."""
    rank = np.full(len(batches.cost), len(chosen))
    rank[chosen] = np.arange(len(chosen))
    by_rank = np.argsort(rank[batches.members], kind="stable")
    return by_rank[: int(np.count_nonzero(rank[batches.members] < len(chosen)))]


@dataclass(frozen=True, eq=False)
class _Batches:
    """Bricks that move together; `members` (bricks,) is the batch of each brick, all else is (batches,)."""

    members: NDArray[np.int64]
    source: NDArray[np.int64]
    target: NDArray[np.int64]
    cost: NDArray[np.float64]
    wire: NDArray[np.int64]
    held: NDArray[np.int64]


def _batches(present: Owners, goal: Goal, bricks: NDArray[np.int64], budget_bytes: int) -> _Batches:
    at = tuple(bricks.T)
    source, target = present.owner[at].astype(np.int64), goal.target.owner[at].astype(np.int64)
    key = (goal.unit[at] * present.ranks + source) * present.ranks + target
    _, first, members = np.unique(key, return_index=True, return_inverse=True)
    members = members.reshape(-1)
    wire = np.bincount(members, goal.wire_bytes[at]).astype(np.int64)
    if (wire > budget_bytes).any():
        # A unit that exceeds the budget moves brick by brick.
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
    """Choose batches greedily: each time the best head of the queues, one queue for each source and target."""
    loads, free = loads.copy(), free_bytes.copy()
    wire = np.maximum(batches.wire, 1)
    route = batches.source * len(loads) + batches.target
    queue = np.lexsort((-batches.cost / wire, route))
    heads = np.flatnonzero(np.diff(route[queue], prepend=-1))
    ends = np.append(heads[1:], len(queue))
    chosen: list[int] = []
    while len(heads):
        first = queue[heads]
        fits = (batches.wire[first] <= budget_bytes) & (batches.held[first] <= free[batches.target[first]])
        heads = heads + ~fits
        if fits.any():
            source, target, cost = batches.source[first], batches.target[first], batches.cost[first]
            gain = cost * (loads[source] - loads[target] - cost)
            # Batches without a gain come last, the least loss first.
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
