"""Static assignment, recomputed when an unassigned brick becomes visible: the common part of static distributions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.distribution.memory_budget import MemoryBudget, check_memory
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan, shows_more

Assigned = TypeVar("Assigned")


class StaticAssignment(Generic[Assigned]):
    """Assignment of bricks to ranks that is kept from frame to frame.

    Parameters
    ----------
    ranks : number of ranks
    budget : memory of a rank for bricks
    assign : from the cost of bricks and a number of ranks to an assignment
    sums : from an assignment and an integer for each brick to the sum over each rank's bricks, int64 (ranks,)
    bricks : from an assignment, a rank and the cost to the rank's visible bricks, int64 (m, 3)
    """

    def __init__(
        self,
        ranks: int,
        budget: MemoryBudget,
        assign: Callable[[Costs, int], Assigned],
        sums: Callable[[Assigned, NDArray[np.int64]], NDArray[np.int64]],
        bricks: Callable[[Assigned, int, Costs], NDArray[np.int64]],
    ) -> None:
        self._ranks, self._budget = ranks, budget
        self._assign, self._sums, self._bricks = assign, sums, bricks
        self._current: tuple[Assigned, Costs] | None = None

    def update(self, plan: Plan) -> Assigned:
        """Return the assignment: the same object as before, or a new one if it was recomputed.

        Raises
        ------
        InputError
            The bricks of a rank do not fit into its memory.
        """
        if self._current is None or shows_more(plan, self._current[1]):
            cost, sizes, limit = plan.cost, self._budget.brick_bytes(plan), self._budget.limit_bytes
            check_memory(lambda n: self._sums(self._assign(cost, n), sizes), self._ranks, sizes, limit)
            self._current = self._assign(cost, self._ranks), cost
        return self._current[0]

    def holds(self, rank: int) -> frozenset[Index]:
        """Return a rank's bricks that were visible when they were assigned."""
        if self._current is None:
            return frozenset()
        assigned, cost = self._current
        return frozenset((z, y, x) for z, y, x in self._bricks(assigned, rank, cost).tolist())
