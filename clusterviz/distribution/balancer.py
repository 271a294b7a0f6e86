"""Load balancer: fronts follow the expected cost, and bricks follow the fronts at a bounded rate.

    measure -> predict -> place fronts -> choose the moves of this frame (`rebalance`) -> hand over arrived bricks

One frozen value goes from frame to frame. Only pure functions change it, so ranks with the same inputs agree without
communication.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.distribution.brick_cost import Measured, measure, predict, unmeasured
from clusterviz.distribution.flights import Migration, Move, arrive, hand_over, launch, settled
from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.edges import refined_edges, units
from clusterviz.partition.fronts import PARALLEL_ORIGIN, RayOrigin, front_owners
from clusterviz.partition.owners import UNASSIGNED, Owners
from clusterviz.partition.search import move_planes, search_tree
from clusterviz.partition.tree import BspTree, Index

HYSTERESIS = 0.01  # fronts stay if moving them lowers the cost of the busiest rank by no more than this share
UNIT = 8  # longest side of blocks that move whole, in bricks; they are small near the planes of the tree


@dataclass(frozen=True)
class Policy:
    """Settings of the load balancer."""

    budget_bytes: int  # that all ranks together may start to send in a frame
    limit_bytes: int  # of bricks that a rank may hold


@dataclass(frozen=True, eq=False)
class Balance:
    """State of the load balancer between two frames."""

    measured: Measured  # cost factors of the bricks
    tree: BspTree  # axes of the fronts, and the planes that fronts replace
    aim: Costs  # float64 (bz, by, bx), cost by which fronts were placed last
    target: Owners  # owners by the fronts
    migration: Migration  # present owners, flights and caches
    recalled: NDArray[np.int64]  # int64 (ranks,), bricks of this frame's moves that each target has in its cache
    wire_bytes: NDArray[np.int64]  # int64 (bz, by, bx), size of each brick in a message


def first_owners(model: Costs, ranks: int, eye: RayOrigin = PARALLEL_ORIGIN) -> Owners:
    """Return the owners in the first frame; parameters as in `begin`."""
    return front_owners(search_tree(model, ranks), model, eye)


def begin(
    model: Costs,
    ranks: int,
    brick_bytes: NDArray[np.int64],
    policy: Policy,
    eye: RayOrigin = PARALLEL_ORIGIN,
    wire_bytes: NDArray[np.int64] | None = None,
) -> Balance:
    """Return the state before the first frame, with fronts by the model.

    Parameters
    ----------
    model : float64 (bz, by, bx), expected cost of each brick; above 0 for bricks that are visible
    brick_bytes : int64 (bz, by, bx), size of each brick in memory; 0 for bricks that are not visible
    wire_bytes : int64 (bz, by, bx), size of each brick in a message; None: `brick_bytes`
    """
    tree = search_tree(model, ranks)
    owners = front_owners(tree, model, eye)
    migration = settled(owners, brick_bytes, policy.limit_bytes)
    wire = brick_bytes if wire_bytes is None else wire_bytes
    return Balance(unmeasured(tree.shape_zyx), tree, model, owners, migration, np.zeros(ranks, np.int64), wire)


def complete(balance: Balance, arrived: Collection[Index]) -> Balance:
    """Record after a frame that bricks have arrived; `plan_moves` decides when their targets draw them."""
    return replace(balance, migration=arrive(balance.migration, arrived))


def learn(balance: Balance, model: Costs, costs: NDArray[np.float64]) -> Balance:
    """Learn after a frame from its cost on each rank, `costs` float64 (ranks,), and the expected cost, `model`."""
    return replace(balance, measured=measure(balance.measured, model, balance.migration.owners, costs))


def skip(balance: Balance) -> Balance:
    """Return the state before a frame without new moves."""
    return replace(balance, recalled=np.zeros_like(balance.recalled))


def plan_moves(balance: Balance, model: Costs, policy: Policy, eye: RayOrigin = PARALLEL_ORIGIN) -> Balance:
    """Place fronts before a frame by its expected cost, plan moves, and hand over bricks that have arrived.

    New flights have the stage "planned". Bricks in the caches of their targets may be handed over at once. Errors as of
    `rebalance`.
    """
    cost = predict(balance.measured, model, balance.migration.brick_bytes > 0)
    if not cost.any():
        return skip(balance)
    balance = _aimed(balance, cost, eye)
    migration = _move_empty(balance)
    goal = _goal(replace(balance, migration=migration), cost)
    moves = rebalance(migration.landed, goal, migration.free_bytes, policy.budget_bytes, migration.moving)
    launched = launch(migration, moves)
    return replace(balance, migration=hand_over(launched, cost), recalled=_recalled(migration, launched))


def _aimed(balance: Balance, cost: Costs, eye: RayOrigin) -> Balance:
    """Turn the fronts to the eye; move them to the cost if that clearly relieves the busiest rank."""
    target = front_owners(balance.tree, balance.aim, eye)
    busiest = float(target.loads(cost).max())
    if busiest > (1 + HYSTERESIS) * float(cost.sum()) / balance.tree.ranks:
        moved = front_owners(balance.tree, cost, eye)
        if busiest > (1 + HYSTERESIS) * float(moved.loads(cost).max()):
            return replace(balance, tree=move_planes(balance.tree, cost), aim=cost, target=moved)
    return replace(balance, target=target)


def _move_empty(balance: Balance) -> Migration:
    """Assign bricks without bytes to their targets at once, so that visibility orders whole boxes."""
    migration = balance.migration
    owner = np.where(migration.brick_bytes == 0, balance.target.owner, migration.owners.owner)
    return replace(migration, owners=Owners(migration.owners.ranks, owner.astype(np.int32)))


def _goal(balance: Balance, cost: Costs) -> Goal:
    migration, target = balance.migration, balance.target
    wire = balance.wire_bytes.copy()
    for rank, bricks in enumerate(migration.cached):
        for brick in bricks:
            if target.owner[brick] == rank:
                wire[brick] = 0
    unit = units(balance.tree.shape_zyx, refined_edges(balance.tree, UNIT))
    return Goal(target, cost, wire, migration.brick_bytes, unit)


def _recalled(before: Migration, launched: Migration) -> NDArray[np.int64]:
    """Count new flights whose brick was in the target's cache, by target."""
    new = launched.flights[len(before.flights) :]
    targets = [flight.target for flight in new if flight.stage == "held" and before.brick_bytes[flight.brick]]
    return np.bincount(np.array(targets, np.int64), minlength=before.owners.ranks)


@dataclass(frozen=True, eq=False)
class Goal:
    """Wanted owners of the bricks, with costs and sizes."""

    target: Owners  # wanted owners; bricks without an owner, here or at present, stay
    cost: Costs  # float64 (bz, by, bx), expected cost
    wire_bytes: NDArray[np.int64]  # int64 (bz, by, bx), size in a message to the target; 0 if the target has the brick
    held_bytes: NDArray[np.int64]  # int64 (bz, by, bx), size in the target's memory
    # int64 (bz, by, bx), as `units` returns it: bricks of a unit with the same source and target move together
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

    Returns moves of each brick at most once, at most `budget_bytes` in all messages and `free_bytes` into each rank;
    empty if the goal is reached or nothing fits. A budget smaller than every brick that should move raises InputError.

    Parameters
    ----------
    free_bytes : int64 (ranks,), free memory of each rank
    budget_bytes : that all ranks together may send in a frame; 0: only bricks that their targets have already
    moving : bool (bz, by, bx), bricks in flight, which must not move
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
    maps = (present.owner, goal.target.owner, goal.wire_bytes)
    some = ((z, y, x) for z, y, x in bricks[_of_batches(batches, chosen)].tolist())
    return tuple(Move(brick, *(int(each[brick]) for each in maps)) for brick in some)


def _of_batches(batches: _Batches, chosen: list[int]) -> NDArray[np.int64]:
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
    first, members = _grouped(key)
    wire = np.bincount(members, goal.wire_bytes[at])
    if (wire > budget_bytes).any():
        # A unit that exceeds the budget moves brick by brick.
        first, members = _grouped(
            np.where((wire > budget_bytes)[members], len(first) + np.arange(len(bricks)), members)
        )
    wire, held = (np.bincount(members, each[at]).astype(np.int64) for each in (goal.wire_bytes, goal.held_bytes))
    cost = np.asarray(np.bincount(members, goal.cost[at]), np.float64)
    return _Batches(members, source[first], target[first], cost, wire, held)


def _grouped(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the index of the first key of each group of equal keys, and the group of each key."""
    _, first, members = np.unique(keys, return_index=True, return_inverse=True)
    return first, members.reshape(-1)


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
