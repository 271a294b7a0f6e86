"""Static coherent distribution: a BSP tree with one leaf and one partial image for each rank."""

from __future__ import annotations

from collections.abc import Sequence

from clusterviz.data.source import Index
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.distribution.static import StaticAssignment
from clusterviz.frame.work import Mode
from clusterviz.partition import BspTree, Piece, bricks_of, build_tree, leaf_pieces, owners_of
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame


class Coherent:
    """Static BSP tree by the number of visible cells; rebuilt when an unassigned brick becomes visible.

    Parameters
    ----------
    ranks : number of ranks
    budget : memory of a rank for bricks
    """

    mode: Mode = "sort-last"

    def __init__(self, ranks: int, budget: MemoryBudget) -> None:
        self._tree = StaticAssignment[BspTree](
            ranks, budget, build_tree, lambda tree, amount: owners_of(tree).sums(amount), bricks_of
        )

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """Return one piece for each leaf with visible bricks. Raises as `StaticAssignment.update`."""
        tree = self._tree.update(plan)
        return leaf_pieces(tree, plan.cost, plan.eye_in_bricks(), plan.view.forward)

    def holds(self, rank: int) -> frozenset[Index]:
        """Return the bricks of a rank's leaf that were visible when the tree was built."""
        return self._tree.holds(rank)

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Do nothing: a static distribution ignores costs."""
