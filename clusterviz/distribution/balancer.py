"""The dynamic distribution: fronts follow the expected cost, and bricks follow the fronts at a bounded rate.

    measure -> predict -> where should fronts be -> which bricks move this frame -> what is in flight

One frozen value goes from frame to frame. It changes by pure functions only, so ranks that are told the same numbers
agree on everything without asking each other.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.distribution.flights import Migration, arrive, hand_over, launch, settled
from clusterviz.distribution.measured_cost import Measured, measure, predict, unmeasured
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
    """How eagerly to balance.

    Attributes
    ----------
    budget_bytes : that all ranks together may start to send in a frame
    limit_bytes : of bricks that a rank may hold
    damping : the weight of the past in what is measured
    hysteresis : fronts stay where the busiest rank would have at most this share more than it could
    unit : side of what fronts leave whole, in bricks; where `refined`, of what moves as one far from them
    refined : fronts divide down to single bricks
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
    """What frame n + 1 takes over from frame n.

    Attributes
    ----------
    measured : what was learnt of each brick
    tree : the axes of the fronts, and where planes would be in their stead
    aim : float64 (bz, by, bx), the cost by which fronts were placed last
    target : who should draw what
    migration : who draws what now, and what is in flight
    recalled : int64 (ranks,), bricks that each rank is told to take before this frame and has in its cache
    wire_bytes : int64 (bz, by, bx), what sending a brick takes
    """

    measured: Measured
    tree: BspTree
    aim: Costs
    target: Owners
    migration: Migration
    recalled: NDArray[np.int64]
    wire_bytes: NDArray[np.int64]


def first_owners(model: Costs, ranks: int, policy: Policy, eye: RayOrigin = PARALLEL_ORIGIN) -> Owners:
    """Who draws what in the first frame; parameters as of `begin`."""
    return front_owners(search_tree(model, ranks), model, eye, _atoms(policy, model.shape))


def begin(
    model: Costs,
    ranks: int,
    brick_bytes: NDArray[np.int64],
    policy: Policy,
    eye: RayOrigin = PARALLEL_ORIGIN,
    wire_bytes: NDArray[np.int64] | None = None,
) -> Balance:
    """Before the first frame: fronts by the model.

    Parameters
    ----------
    model : float64 (bz, by, bx), expected cost of each brick; above 0 where it has something to show
    brick_bytes : int64 (bz, by, bx), what holding a brick takes; 0 for those that have nothing to show
    eye : as of `ray_origin`
    wire_bytes : of the same shape, what sending a brick takes; None: as much

    Raises
    ------
    InputError
        A share does not fit into the memory of a rank.
    """
    owners = first_owners(model, ranks, policy, eye)
    migration = settled(owners, brick_bytes, policy.limit_bytes)
    tree = search_tree(model, ranks)
    wire = brick_bytes if wire_bytes is None else wire_bytes
    return Balance(unmeasured(tree.shape_zyx), tree, model, owners, migration, np.zeros(ranks, np.int64), wire)


def complete(balance: Balance, arrived: Collection[Index]) -> Balance:
    """After a frame: these bricks are at their targets; when these draw them, `plan_moves` decides."""
    return replace(balance, migration=arrive(balance.migration, arrived))


def learn(balance: Balance, model: Costs, costs: NDArray[np.float64], policy: Policy) -> Balance:
    """After a frame: what it cost each rank, `costs` float64 (ranks,), where `model` was expected."""
    return replace(balance, measured=measure(balance.measured, model, balance.migration.owners, costs, policy.damping))


def skip(balance: Balance) -> Balance:
    """Before a frame for which nothing moves: nobody is told to take anything."""
    return replace(balance, recalled=np.zeros_like(balance.recalled))


def plan_moves(balance: Balance, model: Costs, policy: Policy, eye: RayOrigin = PARALLEL_ORIGIN) -> Balance:
    """Before a frame of which `model` is expected: put fronts where they should be, plan what can move, hand over.

    New flights are those of stage "planned"; what their targets have in their caches may change hands at once.

    Raises
    ------
    InputError
        The budget cannot carry a single brick.
    """
    cost = predict(balance.measured, model, balance.migration.brick_bytes > 0)
    if not cost.any():
        return skip(balance)
    balance = _aimed(balance, cost, policy, eye)
    migration = _unheld_moved(balance)
    goal = _goal(replace(balance, migration=migration), cost, policy)
    moves = rebalance(migration.landed, goal, migration.free_bytes, policy.budget_bytes, migration.moving)
    launched = launch(migration, moves)
    return replace(balance, migration=hand_over(launched, cost), recalled=_recalled(migration, launched))


def _aimed(balance: Balance, cost: Costs, policy: Policy, eye: RayOrigin) -> Balance:
    """Fronts where they are, turned to the eye; or where the cost is, if that leaves the busiest rank clearly less."""
    atoms, ranks = _atoms(policy, cost.shape), balance.tree.ranks
    target = front_owners(balance.tree, balance.aim, eye, atoms)
    busiest = float(target.loads(cost).max())
    if busiest > (1 + policy.hysteresis) * float(cost.sum()) / ranks:
        moved = front_owners(balance.tree, cost, eye, atoms)
        if busiest > (1 + policy.hysteresis) * float(moved.loads(cost).max()):
            return replace(balance, tree=move_planes(balance.tree, cost), aim=cost, target=moved)
    return replace(balance, target=target)


def _unheld_moved(balance: Balance) -> Migration:
    """Bricks that nobody holds go where they should be at once, so that shares stay whole boxes to order."""
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
    """Between what fronts leave whole."""
    z, y, x = shape
    return uniform_edges((z, y, x), 1 if policy.refined else policy.unit)


def _recalled(before: Migration, launched: Migration) -> NDArray[np.int64]:
    """Bricks with bytes that have arrived as soon as they were launched, by target."""
    new = launched.flights[len(before.flights) :]
    back = [flight.target for flight in new if flight.stage == "held" and before.brick_bytes[flight.brick]]
    return np.bincount(np.array(back, np.int64), minlength=before.owners.ranks)
