"""The static interleaved distribution: blocks of bricks dealt round robin, so that a dear region is dear for all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.data.source import Index
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.distribution.static import StaticAssignment
from clusterviz.partition import Owners, Piece, interleave, owner_pieces
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame

BLOCKS_A_RANK = 8  # at least: few leave ranks uneven, many make many images


class Interleaved:
    """Blocks stay where they are until a plan shows a brick that nobody holds.

    Parameters
    ----------
    ranks : how many there are
    holding : what a rank may hold
    """

    def __init__(self, ranks: int, budget: MemoryBudget) -> None:
        self._owners = StaticAssignment[Owners](
            ranks, budget, _dealt, Owners.sums, lambda owners, rank, _: owners.bricks(rank)
        )

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """A piece for each group of blocks that can be drawn whole. Raises what `StaticAssignment.under` does."""
        owners = self._owners.under(plan)
        return owner_pieces(owners, plan.eye_in_bricks(), plan.view.forward)

    def holds(self, rank: int) -> frozenset[Index]:
        """The bricks of its blocks that could be seen when they were dealt."""
        return self._owners.holds(rank)

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Nothing: what is static does not follow the cost."""


def _dealt(cost: Costs, ranks: int) -> Owners:
    """The largest blocks of which every rank has enough."""
    block, drawn = 1, np.argwhere(cost > 0)
    while len(np.unique(drawn // (2 * block), axis=0)) >= BLOCKS_A_RANK * ranks:
        block *= 2
    return interleave(cost, ranks, block)
