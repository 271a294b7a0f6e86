"""Load balancer: fronts follow the expected cost, and bricks follow the fronts at a bounded rate.

    measure -> predict -> place fronts -> choose the moves of this frame -> hand over bricks that have arrived

One frozen value goes from frame to frame. Only pure functions change it, so ranks with the same inputs agree without
communication.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.distribution.brick_cost import Measured, measure, predict, unmeasured
from clusterviz.distribution.flights import Migration, arrive, hand_over, launch, settled
from clusterviz.distribution.rebalance import Goal, rebalance
from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.edges import Edges, refined_edges, uniform_edges, units
from clusterviz.partition.fronts import PARALLEL_ORIGIN, RayOrigin, front_owners
from clusterviz.partition.owners import Owners
from clusterviz.partition.search import move_planes, search_tree
from clusterviz.partition.tree import BspTree, Index


@dataclass(frozen=True)
class Policy:
    """Settings of the load balancer.

    Attributes
    ----------
    budget_bytes : that all ranks together may start to send in a frame
    limit_bytes : of bricks that a rank may hold
    damping : weight of earlier frames in the measured cost
    hysteresis : fronts stay if moving them would lower the cost of the busiest rank by no more than this share
    unit : side, in bricks, of blocks that fronts do not divide; if `refined`, of blocks far from fronts that move whole
    refined : fronts may divide blocks down to single bricks
    """

    budget_bytes: int
    limit_bytes: int
    damping: float = 0.0
    hysteresis: float = 0.01
    unit: int = 1
    refined: bool = False

    def __post_init__(self) -> None:
        if min(self.budget_bytes, self.limit_bytes, self.hysteresis) < 0 or self.unit < 1:
            raise InputError("impossible", where="balance", found=self, allowed="nothing negative, units of 1 or more")


@dataclass(frozen=True, eq=False)
class Balance:
    """State of the load balancer between two frames.

    Attributes
    ----------
    measured : cost factors of the bricks
    tree : axes of the fronts, and the planes that fronts replace
    aim : float64 (bz, by, bx), cost by which fronts were placed last
    target : owners by the fronts
    migration : present owners, flights and caches
    recalled : int64 (ranks,), bricks of this frame's moves that each target has in its cache
    wire_bytes : int64 (bz, by, bx), size of each brick in a message
    """

    measured: Measured
    tree: BspTree
    aim: Costs
    target: Owners
    migration: Migration
    recalled: NDArray[np.int64]
    wire_bytes: NDArray[np.int64]


def first_owners(model: Costs, ranks: int, policy: Policy, eye: RayOrigin = PARALLEL_ORIGIN) -> Owners:
    """Return the owners in the first frame; parameters as in `begin`."""
    return front_owners(search_tree(model, ranks), model, eye, _atoms(policy, model.shape))


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
    eye : as `ray_origin` returns it
    wire_bytes : int64 (bz, by, bx), size of each brick in a message; None: `brick_bytes`

    Raises
    ------
    InputError
        The bricks of a rank do not fit into its memory.
    """
    owners = first_owners(model, ranks, policy, eye)
    migration = settled(owners, brick_bytes, policy.limit_bytes)
    tree = search_tree(model, ranks)
    wire = brick_bytes if wire_bytes is None else wire_bytes
    return Balance(unmeasured(tree.shape_zyx), tree, model, owners, migration, np.zeros(ranks, np.int64), wire)


def complete(balance: Balance, arrived: Collection[Index]) -> Balance:
    """Record after a frame that bricks have arrived; `plan_moves` decides when their targets draw them."""
    return replace(balance, migration=arrive(balance.migration, arrived))


def learn(balance: Balance, model: Costs, costs: NDArray[np.float64], policy: Policy) -> Balance:
    """Learn after a frame from its cost on each rank, `costs` float64 (ranks,), and the expected cost, `model`."""
    return replace(balance, measured=measure(balance.measured, model, balance.migration.owners, costs, policy.damping))


def skip(balance: Balance) -> Balance:
    """Return the state before a frame without new moves."""
    return replace(balance, recalled=np.zeros_like(balance.recalled))


def plan_moves(balance: Balance, model: Costs, policy: Policy, eye: RayOrigin = PARALLEL_ORIGIN) -> Balance:
    """Place fronts before a frame by its expected cost, plan moves, and hand over bricks that have arrived.

    New flights have the stage "planned". Bricks in the caches of their targets may be handed over at once.

    Raises
    ------
    InputError
        The budget is smaller than a single brick.
    """
    cost = predict(balance.measured, model, balance.migration.brick_bytes > 0)
    if not cost.any():
        return skip(balance)
    balance = _aimed(balance, cost, policy, eye)
    migration = _move_empty(balance)
    goal = _goal(replace(balance, migration=migration), cost, policy)
    moves = rebalance(migration.landed, goal, migration.free_bytes, policy.budget_bytes, migration.moving)
    launched = launch(migration, moves)
    return replace(balance, migration=hand_over(launched, cost), recalled=_recalled(migration, launched))


def _aimed(balance: Balance, cost: Costs, policy: Policy, eye: RayOrigin) -> Balance:
    """Turn the fronts to the eye; move them to the cost if that clearly relieves the busiest rank."""
    atoms, ranks = _atoms(policy, cost.shape), balance.tree.ranks
    target = front_owners(balance.tree, balance.aim, eye, atoms)
    busiest = float(target.loads(cost).max())
    if busiest > (1 + policy.hysteresis) * float(cost.sum()) / ranks:
        moved = front_owners(balance.tree, cost, eye, atoms)
        if busiest > (1 + policy.hysteresis) * float(moved.loads(cost).max()):
            return replace(balance, tree=move_planes(balance.tree, cost), aim=cost, target=moved)
    return replace(balance, target=target)


def _move_empty(balance: Balance) -> Migration:
    """Assign bricks without bytes to their targets at once, so that visibility orders whole boxes."""
    migration = balance.migration
    owner = np.where(migration.brick_bytes == 0, balance.target.owner, migration.owners.owner)
    return replace(migration, owners=Owners(migration.owners.ranks, owner.astype(np.int32)))


def _goal(balance: Balance, cost: Costs, policy: Policy) -> Goal:
    migration, target = balance.migration, balance.target
    wire = balance.wire_bytes.copy()
    for rank, bricks in enumerate(migration.cached):
        for brick in bricks:
            if target.owner[brick] == rank:
                wire[brick] = 0
    edges = refined_edges(balance.tree, policy.unit) if policy.refined else _atoms(policy, cost.shape)
    return Goal(target, cost, wire, migration.brick_bytes, units(balance.tree.shape_zyx, edges))


def _atoms(policy: Policy, shape: tuple[int, ...]) -> Edges:
    """Return the edges of the blocks that fronts do not divide."""
    z, y, x = shape
    return uniform_edges((z, y, x), 1 if policy.refined else policy.unit)


def _recalled(before: Migration, launched: Migration) -> NDArray[np.int64]:
    """Count new flights whose brick was in the target's cache, by target."""
    new = launched.flights[len(before.flights) :]
    targets = [flight.target for flight in new if flight.stage == "held" and before.brick_bytes[flight.brick]]
    return np.bincount(np.array(targets, np.int64), minlength=before.owners.ranks)
