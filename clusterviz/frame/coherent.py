"""The static coherent distribution: a tree by the bricks' cells, one leaf a rank, one partial image a leaf."""

from __future__ import annotations

from collections.abc import Sequence

from clusterviz.balance import check_memory
from clusterviz.data.source import Index
from clusterviz.partition import BspTree, Piece, bricks_of, build_tree, leaf_pieces, owners_of
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan, shows_more
from clusterviz.render.storage import brick_bytes
from clusterviz.report.statistics import RankFrame


class Coherent:
    """Leaves stay as they are until a plan shows a brick that nobody holds.

    Parameters
    ----------
    ranks : how many there are
    limit_bytes : of bricks that a rank may hold; None: any
    """

    def __init__(self, ranks: int, limit_bytes: int | None = None) -> None:
        self._ranks, self._limit_bytes = ranks, limit_bytes
        self._tree: BspTree | None = None
        self._dealt: Costs | None = None

    def deal(self, plan: Plan) -> tuple[Piece, ...]:
        """A piece a leaf that shows something.

        Raises
        ------
        InputError
            A share does not fit into the memory of a rank.
        """
        if self._tree is None or shows_more(plan, self._dealt):
            cost, sizes = plan.cost, brick_bytes(plan)
            check_memory(lambda n: owners_of(build_tree(cost, n)).sums(sizes), self._ranks, sizes, self._limit_bytes)
            self._tree, self._dealt = build_tree(cost, self._ranks), cost
        return leaf_pieces(self._tree, plan.cost, plan.view.eye_point, plan.view.forward, plan.layout.brick)

    def holds(self, rank: int) -> frozenset[Index]:
        """The bricks of its leaf that could be seen when the tree was built."""
        if self._tree is None or self._dealt is None:
            return frozenset()
        return frozenset((z, y, x) for z, y, x in bricks_of(self._tree, rank, self._dealt).tolist())

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Nothing: what is static does not follow the cost."""
