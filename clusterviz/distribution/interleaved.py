"""Static interleaved distribution: blocks of bricks, round robin, so that all ranks share an expensive region."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.data.source import Index
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.distribution.static import StaticAssignment
from clusterviz.frame.work import Mode
from clusterviz.partition import Owners, Piece, interleave, owner_pieces
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame

BLOCKS_A_RANK = 8  # at least: fewer balance worse, more make more partial images


class Interleaved:
    """Static assignment of blocks, recomputed when an unassigned brick becomes visible.

    Parameters
    ----------
    ranks : number of ranks
    budget : memory of a rank for bricks
    """

    mode: Mode = "sort-last"

    def __init__(self, ranks: int, budget: MemoryBudget) -> None:
        self._owners = StaticAssignment[Owners](
            ranks, budget, _interleave, Owners.sums, lambda owners, rank, _: owners.bricks(rank)
        )

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """Return one piece for each group of blocks that can be drawn whole. Raises as `StaticAssignment.update`."""
        owners = self._owners.update(plan)
        return owner_pieces(owners, plan.eye_in_bricks(), plan.view.forward)

    def holds(self, rank: int) -> frozenset[Index]:
        """Return the bricks of a rank's blocks that were visible when they were assigned."""
        return self._owners.holds(rank)

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Do nothing: a static distribution ignores costs."""


def _interleave(cost: Costs, ranks: int) -> Owners:
    """Assign blocks, as large as leave each rank `BLOCKS_A_RANK`."""
    block, drawn = 1, np.argwhere(cost > 0)
    while len(np.unique(drawn // (2 * block), axis=0)) >= BLOCKS_A_RANK * ranks:
        block *= 2
    return interleave(cost, ranks, block)
