"""Static distributions: bricks stay where they are assigned until an unassigned one becomes visible.

coherent     a BSP tree by the number of visible cells, with one leaf and one partial image for each rank
interleaved  blocks of bricks, round robin, so that all ranks share an expensive region; more partial images
replicated   several ranks hold each brick, and the cost in earlier frames decides which of them draws it
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.distribution.brick_cost import expected_samples, measure, predict, rank_costs, unmeasured
from clusterviz.distribution.memory_budget import MemoryBudget, check_passes
from clusterviz.frame.work import Mode
from clusterviz.partition import (
    BspTree,
    Owners,
    Piece,
    Replicas,
    assign_replicas,
    bricks_of,
    build_tree,
    interleave,
    leaf_pieces,
    owner_pieces,
    owners_of,
    replicate,
)
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan, shows_more
from clusterviz.report.statistics import RankFrame

BLOCKS_A_RANK = 8  # of interleaved blocks, at least: fewer balance worse, more make more partial images
Assigned = TypeVar("Assigned")


class StaticDistribution(Generic[Assigned]):
    """Distribution by an assignment of bricks to ranks that is recomputed when an unassigned brick becomes visible.

    Parameters
    ----------
    assign : from the cost of bricks and a number of ranks to an assignment
    sums : from an assignment and an integer for each brick to the sum over each rank's bricks, int64 (ranks,)
    bricks : from an assignment, a rank and the cost to the rank's visible bricks, int64 (m, 3)
    pieces : from an assignment and a plan to pieces
    """

    mode: Mode = "sort-last"

    def __init__(
        self,
        ranks: int,
        budget: MemoryBudget,
        assign: Callable[[Costs, int], Assigned],
        sums: Callable[[Assigned, NDArray[np.int64]], NDArray[np.int64]],
        bricks: Callable[[Assigned, int, Costs], NDArray[np.int64]],
        pieces: Callable[[Assigned, Plan], tuple[Piece, ...]],
    ) -> None:
        self._ranks, self._budget = ranks, budget
        self._assign, self._sums, self._bricks, self._pieces = assign, sums, bricks, pieces
        self._current: tuple[Assigned, Costs] | None = None

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """Return one piece for each part of a rank that can be drawn whole. Raises as `update`."""
        return self._pieces(self.update(plan), plan)

    def update(self, plan: Plan) -> Assigned:
        """Return the assignment: the same object as before, or a new one if it was recomputed.

        Raises InputError if the bricks of a rank do not fit into its memory; if they are drawn in passes, one
        does not.
        """
        if self._current is None or shows_more(plan, self._current[1]):
            cost, sizes = plan.cost, self._budget.brick_bytes(plan)
            if plan.has_passes:
                check_passes(plan, sizes, self._budget.limit_bytes)
            else:
                self._budget.check(lambda n: self._sums(self._assign(cost, n), sizes), self._ranks, sizes)
            self._current = self._assign(cost, self._ranks), cost
        return self._current[0]

    def holds(self, rank: int) -> frozenset[Index]:
        """Return a rank's bricks that were visible when they were assigned."""
        if self._current is None:
            return frozenset()
        assigned, cost = self._current
        return frozenset((z, y, x) for z, y, x in self._bricks(assigned, rank, cost).tolist())

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Do nothing: the assignment ignores costs."""


class Coherent(StaticDistribution[BspTree]):
    """BSP tree by the number of visible cells."""

    def __init__(self, ranks: int, budget: MemoryBudget) -> None:
        super().__init__(ranks, budget, build_tree, lambda tree, n: owners_of(tree).sums(n), bricks_of, _leaf_pieces)


def _leaf_pieces(tree: BspTree, plan: Plan) -> tuple[Piece, ...]:
    return leaf_pieces(tree, plan.cost, plan.eye_in_bricks(), plan.view.forward)


def _owner_pieces(owners: Owners, plan: Plan) -> tuple[Piece, ...]:
    return owner_pieces(owners, plan.eye_in_bricks(), plan.view.forward)


class Interleaved(StaticDistribution[Owners]):
    """Blocks of bricks, round robin."""

    def __init__(self, ranks: int, budget: MemoryBudget) -> None:
        super().__init__(ranks, budget, _interleave, Owners.sums, lambda own, rank, _: own.bricks(rank), _owner_pieces)


def _interleave(cost: Costs, ranks: int) -> Owners:
    """Assign blocks, as large as leave each rank `BLOCKS_A_RANK`."""
    block, drawn = 1, np.argwhere(cost > 0)
    while len(np.unique(drawn // (2 * block), axis=0)) >= BLOCKS_A_RANK * ranks:
        block *= 2
    return interleave(cost, ranks, block)


class Replicated(StaticDistribution[Replicas]):
    """Replicas of bricks; of the ranks that hold a brick, one draws it.

    The cost of a brick is the expected number of samples times the factor measured in earlier frames. `copies` ranks
    hold each brick, or all if there are fewer.
    """

    def __init__(self, ranks: int, copies: int, budget: MemoryBudget) -> None:
        def assign(cost: Costs, count: int) -> Replicas:
            return replicate(build_tree(cost, count), min(copies, count))

        super().__init__(ranks, budget, assign, Replicas.sums, _replica_bricks, self._cheapest_pieces)
        self._replicas: Replicas | None = None
        self._measured = unmeasured((1, 1, 1))
        self._owners: Owners | None = None

    def _cheapest_pieces(self, replicas: Replicas, plan: Plan) -> tuple[Piece, ...]:
        """Return the pieces of the ranks to which the cost expected of bricks is assigned."""
        if replicas is not self._replicas:
            self._replicas, self._measured = replicas, unmeasured(replicas.home.shape_zyx)
        expected = predict(self._measured, expected_samples(plan), plan.cost > 0)
        self._owners = assign_replicas(replicas, expected)
        return _owner_pieces(self._owners, plan)

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Learn the cost of bricks from the costs of ranks."""
        if self._owners is not None:
            self._measured = measure(self._measured, expected_samples(plan), self._owners, rank_costs(costs))


def _replica_bricks(replicas: Replicas, rank: int, cost: Costs) -> NDArray[np.int64]:
    return np.argwhere(replicas.holds(rank) & (cost > 0))
