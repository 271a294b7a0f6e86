"""The static replicated distribution: every brick on several ranks, and who of them draws it follows the cost.

What bricks should cost is what the camera is expected to take in them, times what the frames before took of that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.balance import check_memory, expected_samples, measure, predict, rank_costs, unmeasured
from clusterviz.data.source import Index
from clusterviz.partition import Owners, Piece, Replicas, build_tree, owner_pieces, replicate, responsible
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan, shows_more
from clusterviz.render.storage import brick_bytes
from clusterviz.report.statistics import RankFrame


class Replicated:
    """Bricks stay where they are until a plan shows one that nobody holds.

    Parameters
    ----------
    ranks : how many there are
    copies : ranks that hold each brick; no more than there are
    limit_bytes : of bricks that a rank may hold; None: any
    """

    def __init__(self, ranks: int, copies: int, limit_bytes: int | None = None) -> None:
        self._ranks, self._copies, self._limit_bytes = ranks, copies, limit_bytes
        self._replicas: Replicas | None = None
        self._dealt: Costs | None = None
        self._measured = unmeasured((1, 1, 1))
        self._owners: Owners | None = None

    def deal(self, plan: Plan) -> tuple[Piece, ...]:
        """A piece for each group of bricks that one rank draws whole.

        Raises
        ------
        InputError
            A share does not fit into the memory of a rank.
        """
        cost = plan.cost
        if self._replicas is None or shows_more(plan, self._dealt):
            sizes = brick_bytes(plan)
            check_memory(lambda n: self._among(cost, n).sums(sizes), self._ranks, sizes, self._limit_bytes)
            self._replicas, self._dealt = self._among(cost, self._ranks), cost
            self._measured = unmeasured(self._replicas.home.shape_zyx)
        shown = cost > 0
        self._owners = responsible(self._replicas, predict(self._measured, expected_samples(plan), shown))
        return owner_pieces(self._owners, plan.view.eye_point, plan.view.forward, plan.layout.brick)

    def holds(self, rank: int) -> frozenset[Index]:
        """Its copies of bricks that could be seen when they were dealt."""
        if self._replicas is None or self._dealt is None:
            return frozenset()
        held = np.argwhere(self._replicas.holds(rank) & (self._dealt > 0))
        return frozenset((z, y, x) for z, y, x in held.tolist())

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """What bricks cost, from what they cost together."""
        if self._owners is not None:
            self._measured = measure(self._measured, expected_samples(plan), self._owners, rank_costs(costs))

    def _among(self, cost: Costs, ranks: int) -> Replicas:
        return replicate(build_tree(cost, ranks), min(self._copies, ranks))
