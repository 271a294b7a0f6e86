"""The static coherent distribution: a tree by the bricks' cells, one leaf a rank, one partial image a leaf."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.data.source import Index
from clusterviz.partition import BspTree, Piece, bricks_of, build_tree, leaf_pieces
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame


class Coherent:
    """Leaves stay as they are until a plan shows a brick that nobody holds.

    Parameters
    ----------
    ranks : how many there are
    """

    def __init__(self, ranks: int) -> None:
        self._ranks = ranks
        self._tree: BspTree | None = None
        self._dealt: Costs = np.zeros((1, 1, 1))

    def deal(self, plan: Plan) -> tuple[Piece, ...]:
        """A piece a leaf that shows something."""
        if self._tree is None or np.any((plan.cost > 0) & (self._dealt == 0)):
            self._tree, self._dealt = build_tree(plan.cost, self._ranks), plan.cost
        view = plan.view
        eye = None if view.parallel else view.eye
        return leaf_pieces(self._tree, plan.cost, eye, view.forward, plan.layout.brick)

    def holds(self, rank: int) -> frozenset[Index]:
        """The bricks of its leaf that could be seen when the tree was built."""
        if self._tree is None:
            return frozenset()
        return frozenset((z, y, x) for z, y, x in bricks_of(self._tree, rank, self._dealt).tolist())

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Nothing: what is static does not follow the cost."""
