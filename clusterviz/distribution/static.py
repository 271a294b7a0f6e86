"""What stays where it was dealt until a plan shows a brick that nobody holds: the part that static distributions share.

They differ in how they deal, and in who draws what of that in a frame.
"""

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
    """Bricks dealt once.

    Parameters
    ----------
    ranks : how many there are
    holding : what a rank may hold
    deal : from what bricks cost, and a number of ranks, to who holds them
    sums : each rank's sum, int64 (ranks,), of a whole number per brick that it holds
    bricks : int64 (m, 3), those of a rank by index, of a cost that is 0 for bricks which nobody needs
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

    def under(self, plan: Plan) -> Assigned:
        """Who holds what: as before, or dealt anew, which gives another object.

        Raises
        ------
        InputError
            A share does not fit into the memory of a rank.
        """
        if self._current is None or shows_more(plan, self._current[1]):
            cost, sizes, limit = plan.cost, self._budget.brick_bytes(plan), self._budget.limit_bytes
            check_memory(lambda n: self._sums(self._assign(cost, n), sizes), self._ranks, sizes, limit)
            self._current = self._assign(cost, self._ranks), cost
        return self._current[0]

    def holds(self, rank: int) -> frozenset[Index]:
        """A rank's bricks that could be seen when they were dealt."""
        if self._current is None:
            return frozenset()
        assigned, cost = self._current
        return frozenset((z, y, x) for z, y, x in self._bricks(assigned, rank, cost).tolist())
