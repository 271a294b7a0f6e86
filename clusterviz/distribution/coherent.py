"""The static coherent distribution: a tree by the bricks' cells, one leaf a rank, one partial image a leaf."""

from __future__ import annotations

from collections.abc import Sequence

from clusterviz.data.source import Index
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.distribution.static import StaticAssignment
from clusterviz.partition import BspTree, Piece, bricks_of, build_tree, leaf_pieces, owners_of
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame


class Coherent:
    """Leaves stay as they are until a plan shows a brick that nobody holds.

    Parameters
    ----------
    ranks : how many there are
    holding : what a rank may hold
    """

    def __init__(self, ranks: int, budget: MemoryBudget) -> None:
        self._tree = StaticAssignment[BspTree](
            ranks, budget, build_tree, lambda tree, amount: owners_of(tree).sums(amount), bricks_of
        )

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """A piece a leaf that shows something. Raises what `StaticAssignment.under` does."""
        tree = self._tree.under(plan)
        return leaf_pieces(tree, plan.cost, plan.eye_in_bricks(), plan.view.forward)

    def holds(self, rank: int) -> frozenset[Index]:
        """The bricks of its leaf that could be seen when the tree was built."""
        return self._tree.holds(rank)

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Nothing: what is static does not follow the cost."""
