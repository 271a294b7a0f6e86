"""What stays where it was dealt until a plan shows a brick that nobody holds: the part that static distributions share.

They differ in how they deal, and in who draws what of that in a frame.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.balance.memory import check_memory
from clusterviz.data.source import Index
from clusterviz.frame.holding import Holding
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan, shows_more

Dealt = TypeVar("Dealt")


class Standing(Generic[Dealt]):
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
        holding: Holding,
        deal: Callable[[Costs, int], Dealt],
        sums: Callable[[Dealt, NDArray[np.int64]], NDArray[np.int64]],
        bricks: Callable[[Dealt, int, Costs], NDArray[np.int64]],
    ) -> None:
        self._ranks, self._holding = ranks, holding
        self._deal, self._sums, self._bricks = deal, sums, bricks
        self._stands: tuple[Dealt, Costs] | None = None

    def under(self, plan: Plan) -> Dealt:
        """Who holds what: as before, or dealt anew, which gives another object.

        Raises
        ------
        InputError
            A share does not fit into the memory of a rank.
        """
        if self._stands is None or shows_more(plan, self._stands[1]):
            cost, sizes, limit = plan.cost, self._holding.brick_bytes(plan), self._holding.limit_bytes
            check_memory(lambda n: self._sums(self._deal(cost, n), sizes), self._ranks, sizes, limit)
            self._stands = self._deal(cost, self._ranks), cost
        return self._stands[0]

    def holds(self, rank: int) -> frozenset[Index]:
        """A rank's bricks that could be seen when they were dealt."""
        if self._stands is None:
            return frozenset()
        dealt, cost = self._stands
        return frozenset((z, y, x) for z, y, x in self._bricks(dealt, rank, cost).tolist())
