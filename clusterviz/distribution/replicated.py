"""The static replicated distribution: every brick on several ranks, and who of them draws it follows the cost.

What bricks should cost is what the camera is expected to take in them, times what the frames before took of that.
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
from clusterviz.partition import Owners, Piece, Replicas, assign_replicas, build_tree, owner_pieces, replicate
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame


class Replicated:
    """Bricks stay where they are until a plan shows one that nobody holds.

    Parameters
    ----------
    ranks : how many there are
    copies : ranks that hold each brick; no more than there are
    holding : what a rank may hold
    """

    def __init__(self, ranks: int, copies: int, budget: MemoryBudget) -> None:
        def dealt(cost: Costs, among: int) -> Replicas:
            return replicate(build_tree(cost, among), min(copies, among))

        self._held = StaticAssignment[Replicas](ranks, budget, dealt, Replicas.sums, _bricks)
        self._replicas: Replicas | None = None
        self._measured = unmeasured((1, 1, 1))
        self._owners: Owners | None = None

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """A piece for each group of bricks that one rank draws whole. Raises what `StaticAssignment.under` does."""
        before, self._replicas = self._replicas, self._held.under(plan)
        if self._replicas is not before:
            self._measured = unmeasured(self._replicas.home.shape_zyx)
        expected = predict(self._measured, expected_samples(plan), plan.cost > 0)
        self._owners = assign_replicas(self._replicas, expected)
        return owner_pieces(self._owners, plan.eye_in_bricks(), plan.view.forward)

    def holds(self, rank: int) -> frozenset[Index]:
        """Its copies of bricks that could be seen when they were dealt."""
        return self._held.holds(rank)

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """What bricks cost, from what they cost together."""
        if self._owners is not None:
            self._measured = measure(self._measured, expected_samples(plan), self._owners, rank_costs(costs))


def _bricks(replicas: Replicas, rank: int, cost: Costs) -> NDArray[np.int64]:
    """The bricks of a rank that somebody needs."""
    return np.argwhere(replicas.holds(rank) & (cost > 0))
