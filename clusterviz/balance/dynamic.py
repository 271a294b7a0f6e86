"""The dynamic distribution: planes follow the measured cost, and bricks follow the planes at a bounded rate.

    measure -> predict -> where should planes be -> which bricks move this frame -> what is in flight

One frozen value goes from frame to frame. It changes by pure functions only, so ranks that are told the same numbers
agree on everything without asking each other.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.balance.measure import Measured, measure, predict, unmeasured
from clusterviz.balance.migration import Migration, arrive, launch, settled, switch
from clusterviz.balance.rebalance import Wish, rebalance
from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.edges import Edges, refined_edges, uniform_edges, units
from clusterviz.partition.owners import Owners, owners_of
from clusterviz.partition.search import busiest, move_planes, search_tree
from clusterviz.partition.tree import BspTree, Index


@dataclass(frozen=True)
class Policy:
    """How eagerly to balance.

    Attributes
    ----------
    budget_bytes : that all ranks together may start to send in a frame
    limit_bytes : of bricks that a rank may hold
    damping : the weight of the past in what is measured
    hysteresis : planes stay where the busiest rank would have at most this share more than it could
    new_tree : moved planes are preferred to new cuts unless their busiest rank would have this share more
    unit : side of what moves as one, in bricks; where `refined`, the longest
    refined : units are single bricks near planes, and larger away from them
    """

    budget_bytes: int
    limit_bytes: int
    damping: float = 0.0
    hysteresis: float = 0.02
    new_tree: float = 0.03
    unit: int = 1
    refined: bool = False

    def __post_init__(self) -> None:
        if min(self.budget_bytes, self.limit_bytes, self.hysteresis, self.new_tree) < 0 or self.unit < 1:
            raise InputError("impossible", where="balance", found=self, allowed="nothing negative, units of 1 or more")


@dataclass(frozen=True, eq=False)
class Balance:
    """What frame n + 1 takes over from frame n.

    Attributes
    ----------
    measured : what was learnt of each brick
    tree : where planes should be
    leaf_ranks : int64 (ranks,): which rank each leaf is meant for
    migration : who draws what now, and what is in flight
    """

    measured: Measured
    tree: BspTree
    leaf_ranks: NDArray[np.int64]
    migration: Migration

    @property
    def target(self) -> Owners:
        """Who should draw what."""
        return Owners(self.tree.ranks, self.leaf_ranks.astype(np.int32)[owners_of(self.tree).owner])


def begin(model: Costs, ranks: int, brick_bytes: NDArray[np.int64], policy: Policy) -> Balance:
    """Before the first frame: a tree by the model.

    Parameters
    ----------
    model : float64 (bz, by, bx), expected cost of each brick; above 0 where it has something to show
    brick_bytes : int64 (bz, by, bx), 0 for bricks that have nothing to show

    Raises
    ------
    InputError
        A share does not fit into the memory of a rank.
    """
    tree = search_tree(model, ranks, _coarse_edges(policy, model.shape))
    migration = settled(owners_of(tree), brick_bytes, policy.limit_bytes)
    return Balance(unmeasured(tree.shape_zyx), tree, np.arange(ranks), migration)


def land(balance: Balance, arrived: Collection[Index]) -> Balance:
    """Between two frames: these bricks are at their targets, which draw them from now on."""
    return replace(balance, migration=switch(arrive(balance.migration, arrived)))


def learn(balance: Balance, model: Costs, costs: NDArray[np.float64], policy: Policy) -> Balance:
    """After a frame: what it cost each rank, `costs` float64 (ranks,), where `model` was expected."""
    return replace(balance, measured=measure(balance.measured, model, balance.migration.owners, costs, policy.damping))


def steer(balance: Balance, model: Costs, policy: Policy) -> Balance:
    """Before a frame of which `model` is expected: put planes where they should be, and plan what can move.

    New flights are those of stage "planned"; what their targets have in their caches lands with the next `land`.

    Raises
    ------
    InputError
        The budget cannot carry a single brick.
    """
    cost = predict(balance.measured, model, balance.migration.brick_bytes > 0)
    if not cost.any():
        return balance
    balance = _aimed(balance, cost, policy)
    migration = _unheld_moved(balance)
    wish = _wish(replace(balance, migration=migration), cost, policy)
    moves = rebalance(migration.landed, wish, migration.free_bytes, policy.budget_bytes, migration.moving)
    return replace(balance, migration=launch(migration, moves))


def _aimed(balance: Balance, cost: Costs, policy: Policy) -> Balance:
    """The tree to move towards: the same, the same with other planes, or another."""
    tree = balance.tree
    now = float(owners_of(tree).loads(cost).max())
    best = float(cost.sum()) / tree.ranks
    if now <= best * (1 + policy.hysteresis):
        return balance
    moved = move_planes(tree, cost, _edges(policy, tree), policy.hysteresis / 2)
    fresh = search_tree(cost, tree.ranks, _coarse_edges(policy, tree.shape_zyx))
    if now <= min(busiest(moved.root), busiest(fresh.root)) * (1 + policy.hysteresis):
        return balance
    if busiest(moved.root) <= busiest(fresh.root) * (1 + policy.new_tree):
        return replace(balance, tree=moved)
    ranks = _nearest_ranks(owners_of(fresh), balance.migration.landed, balance.migration.brick_bytes)
    return replace(balance, tree=fresh, leaf_ranks=ranks)


def _unheld_moved(balance: Balance) -> Migration:
    """Bricks that nobody holds go where they should be at once, so that shares stay whole boxes to order."""
    migration = balance.migration
    owner = np.where(migration.brick_bytes == 0, balance.target.owner, migration.owners.owner)
    return replace(migration, owners=Owners(migration.owners.ranks, owner.astype(np.int32)))


def _wish(balance: Balance, cost: Costs, policy: Policy) -> Wish:
    migration, target = balance.migration, balance.target
    wire = migration.brick_bytes.copy()
    for rank, bricks in enumerate(migration.cached):
        for brick in bricks:
            if target.owner[brick] == rank:
                wire[brick] = 0
    unit = units(balance.tree.shape_zyx, _edges(policy, balance.tree))
    return Wish(target, cost, wire, migration.brick_bytes, unit)


def _edges(policy: Policy, tree: BspTree) -> Edges:
    """Where the planes of a tree may go from where they are."""
    return refined_edges(tree, policy.unit) if policy.refined else uniform_edges(tree.shape_zyx, policy.unit)


def _coarse_edges(policy: Policy, shape: tuple[int, ...]) -> Edges | None:
    """Where the planes of a new tree may be: with refined units anywhere, since those come after the planes."""
    z, y, x = shape
    return None if policy.refined or policy.unit == 1 else uniform_edges((z, y, x), policy.unit)


def _nearest_ranks(leaves: Owners, present: Owners, brick_bytes: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each leaf of a new tree a rank of its own: where the most bytes are already, the largest overlap first."""
    count = leaves.ranks
    drawn = present.owner >= 0
    pair = leaves.owner[drawn].astype(np.int64) * count + present.owner[drawn]
    overlap = np.bincount(pair, brick_bytes[drawn], minlength=count * count)
    ranks = np.full(count, -1, np.int64)
    taken = np.zeros(count, bool)
    for at in np.argsort(-overlap, kind="stable"):
        leaf, rank = divmod(int(at), count)
        if ranks[leaf] < 0 and not taken[rank]:
            ranks[leaf], taken[rank] = rank, True
    return ranks
