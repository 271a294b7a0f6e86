"""Static replicated distribution: several ranks hold each brick, and the cost decides which of them draws it.

The cost of a brick is the expected number of samples times the factor measured in earlier frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.distribution.expected_cost import expected_samples
from clusterviz.distribution.measured_cost import measure, predict, rank_costs, unmeasured
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.distribution.static import StaticAssignment
from clusterviz.frame.work import Mode
from clusterviz.partition import Owners, Piece, Replicas, assign_replicas, build_tree, owner_pieces, replicate
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame


class Replicated:
    """Static replicas, recomputed when an unassigned brick becomes visible.

    Parameters
    ----------
    ranks : number of ranks
    copies : ranks that hold each brick, at most `ranks`
    budget : memory of a rank for bricks
    """

    mode: Mode = "sort-last"

    def __init__(self, ranks: int, copies: int, budget: MemoryBudget) -> None:
        def assign(cost: Costs, count: int) -> Replicas:
            return replicate(build_tree(cost, count), min(copies, count))

        self._held = StaticAssignment[Replicas](ranks, budget, assign, Replicas.sums, _bricks)
        self._replicas: Replicas | None = None
        self._measured = unmeasured((1, 1, 1))
        self._owners: Owners | None = None

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """Return one piece for each group of bricks that can be drawn whole. Raises as `StaticAssignment.update`."""
        before, self._replicas = self._replicas, self._held.update(plan)
        if self._replicas is not before:
            self._measured = unmeasured(self._replicas.home.shape_zyx)
        expected = predict(self._measured, expected_samples(plan), plan.cost > 0)
        self._owners = assign_replicas(self._replicas, expected)
        return owner_pieces(self._owners, plan.eye_in_bricks(), plan.view.forward)

    def holds(self, rank: int) -> frozenset[Index]:
        """Return a rank's replicas of bricks that were visible when they were assigned."""
        return self._held.holds(rank)

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Learn the cost of bricks from the costs of ranks."""
        if self._owners is not None:
            self._measured = measure(self._measured, expected_samples(plan), self._owners, rank_costs(costs))


def _bricks(replicas: Replicas, rank: int, cost: Costs) -> NDArray[np.int64]:
    """Return the visible bricks of a rank."""
    return np.argwhere(replicas.holds(rank) & (cost > 0))
