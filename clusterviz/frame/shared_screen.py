"""Sort-first and hybrid: groups of ranks share the screen's tiles, and inside a group a tree deals out the data.

As many groups as ranks are sort-first: each rank needs all bricks that its tiles show, and nothing is blended. Where
memory allows, a rank holds all bricks that it may ever show; else those that its tiles show now, and what it has had
before as far as that fits. Windows are shared by all bricks of a group, so every slab is drawn once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.balance.expected import expected_samples
from clusterviz.data.source import Index
from clusterviz.errors import InputError
from clusterviz.frame.holding import Holding
from clusterviz.frame.tiling import TileSettings, Tiling
from clusterviz.partition import BrickBox, BspTree, Piece, build_tree, front_to_back, owners_of
from clusterviz.partition.bsp import Costs, trim
from clusterviz.partition.screen import CostMap, Mosaic, RankGroups, bricks_seen
from clusterviz.plan.plan import Plan, shows_more
from clusterviz.report.statistics import RankFrame

UNEVEN = 1.3  # a group's tree stays until its busiest rank has so many times what a new tree would give it
UNSEEN = 1e-3  # of the mean, for bricks that a group may come to see

Bools = NDArray[np.bool_]


class SharedScreen:
    """Who draws what, where the screen is shared.

    Parameters
    ----------
    groups : the ranks of each
    settings : how tiles are dealt
    holding : what a rank may hold: there is a limit
    several : whether more than one frame may come, for which bricks are kept
    """

    def __init__(self, groups: RankGroups, settings: TileSettings, holding: Holding, several: bool) -> None:
        self._groups, self._several = groups, several
        assert holding.limit_bytes is not None, "more is held where tiles move"
        self._holding, self._brick_bytes, self._limit_bytes = holding, 0, holding.limit_bytes
        self.tiling = Tiling(settings, tuple(map(len, groups)))
        self._trees: list[BspTree] = []
        self._dealt: Costs | None = None
        self._seen: list[Bools] = []
        self._shown: Bools = np.zeros((1, 1, 1), bool)
        self._held: Bools | None = None

    @property
    def mode(self) -> Literal["sort-first", "hybrid"]:
        """What it is to those who composite."""
        return "sort-first" if max(map(len, self._groups)) == 1 else "hybrid"

    @property
    def groups(self) -> RankGroups:
        """The ranks of each group."""
        return self._groups

    def deal(self, plan: Plan) -> tuple[Piece, ...]:
        """The pieces of a frame, group by group; those of a group from front to back in each of its windows.

        Raises
        ------
        InputError
            A rank cannot hold what its tiles show.
        """
        self._shown, self._brick_bytes = plan.cost > 0, int(self._holding.brick_bytes(plan).max())
        mosaic = self._dealt_out(plan)
        # Windows that do not fit give way to those of the last frame, which may.
        if self._largest(self._seen) > self._limit_bytes and self.tiling.step_back():
            mosaic = self._dealt_out(plan)
        self._check_memory()
        return self.pieces(plan, mosaic)

    def pieces(self, plan: Plan, mosaic: Mosaic) -> tuple[Piece, ...]:
        """The pieces of any windows, of what the last deal gave to the groups."""
        view, found = plan.view, []
        for members, tree, seen, windows in zip(self._groups, self._trees, self._seen, mosaic.windows, strict=True):
            leaves = []
            for leaf in front_to_back(tree, view.eye_point, view.forward, plan.layout.brick):
                box = trim(seen.astype(np.float64), tree.leaves[leaf].box)
                if box.bricks:
                    leaves.append((members[leaf], box, _mask(seen, self._shown, box)))
            found += [Piece(rank, box, mask, window) for window in windows for rank, box, mask in leaves]
        return tuple(found)

    def holds(self, rank: int) -> frozenset[Index]:
        """What its tiles show of its leaf; in a loop all that it may show, where all ranks can hold that much."""
        group = next(number for number, members in enumerate(self._groups) if rank in members)
        leaf = self._trees[group].leaves[self._groups[group].index(rank)]
        mine = np.zeros(self._shown.shape, bool)
        mine[leaf.box.slices] = True
        held = mine & self._seen[group]
        if self._several and self._largest([self._shown] * len(self._groups)) <= self._limit_bytes:
            held = mine & self._shown
        elif self._held is not None:
            old = np.argwhere(self._held & mine & self._shown & ~held)
            held[tuple(old[: self._limit_bytes // max(1, self._brick_bytes) - int(held.sum())].T)] = True
        self._held = held
        return frozenset((z, y, x) for z, y, x in np.argwhere(held).tolist())

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Nothing: what a strategy follows is the cost of parts of the screen, not of ranks."""

    def follow(self, cost: CostMap) -> None:
        """What the last frame cost, or what a pre-pass says of this one."""
        self.tiling.learn(cost)

    def _dealt_out(self, plan: Plan) -> Mosaic:
        """The windows of the groups, what they show, and the trees that deal this out."""
        mosaic = self.tiling.mosaic(plan)
        self._seen = [self._shown if self.tiling.is_static else bricks_seen(plan, each) for each in mosaic.windows]
        self._grow(plan)
        return mosaic

    def _grow(self, plan: Plan) -> None:
        """The groups' trees, where the old ones will not do."""
        if self._dealt is None or (self.tiling.is_static and shows_more(plan, self._dealt)):
            self._dealt, self._trees = plan.cost, []
        if self.tiling.is_static or max(map(len, self._groups)) == 1:
            self._trees = self._trees or [build_tree(self._dealt, len(members)) for members in self._groups]
            return
        expected = expected_samples(plan)
        expected = np.where(self._shown, expected + UNSEEN * (expected.mean() or 1.0), 0.0)
        costs = [np.where(seen, expected, 0.0) for seen in self._seen]
        anew = [build_tree(cost, len(members)) for cost, members in zip(costs, self._groups, strict=True)]
        old = self._trees or anew
        self._trees = [
            new if _busiest(kept, cost) > UNEVEN * _busiest(new, cost) else kept
            for kept, new, cost in zip(old, anew, costs, strict=True)
        ]

    def _check_memory(self) -> None:
        """Before anything is loaded: what the tiles show has to fit."""
        most = self._largest(self._seen)
        if most <= self._limit_bytes:
            return
        ranks = sum(map(len, self._groups))
        text = f"the tiles of a rank show {most} bytes of bricks, in {len(self._groups)} groups of {ranks} ranks"
        fewer = next(
            (n for n in range(len(self._groups) - 1, 1, -1) if self._shown_bytes() * n <= self._limit_bytes * ranks), 1
        )
        allowed = "mode: sort-last" if fewer == 1 else f"mode: hybrid with groups: {fewer} or fewer, sort-last"
        raise InputError(text, where="cluster.mode", found=f"{self._limit_bytes} bytes a rank", allowed=allowed)

    def _shown_bytes(self) -> int:
        return int(self._shown.sum()) * self._brick_bytes

    def _largest(self, bricks: Sequence[Bools]) -> int:
        """The most bytes of a rank, of some bricks for each group."""
        loads = (
            owners_of(tree).loads(some.astype(np.float64)).max() for tree, some in zip(self._trees, bricks, strict=True)
        )
        return int(max(loads)) * self._brick_bytes


def _mask(seen: Bools, shown: Bools, box: BrickBox) -> Bools | None:
    """Which bricks of a box are its own, where not all that are shown are."""
    inside = seen[box.slices]
    return None if bool(np.all(inside == shown[box.slices])) else inside


def _busiest(tree: BspTree, cost: Costs) -> float:
    return float(owners_of(tree).loads(cost).max())
