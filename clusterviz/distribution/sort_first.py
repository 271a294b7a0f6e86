"""Sort-first and hybrid distributions: groups of ranks share the tiles of the screen.

Inside a group a BSP tree assigns bricks to ranks. A tile strategy says which tiles each group draws in a frame.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, sections 5.1 and
5.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.distribution.brick_cost import Measured, expected_samples, measure, predict, unmeasured
from clusterviz.distribution.memory_budget import MemoryBudget, check_passes
from clusterviz.errors import InputError
from clusterviz.frame.work import Mode
from clusterviz.image.partial import Rect
from clusterviz.partition import (
    UNASSIGNED,
    BspTree,
    Owners,
    Piece,
    build_tree,
    front_owners,
    move_planes,
    owner_pieces,
    owners_of,
    ray_origin,
    search_tree,
)
from clusterviz.partition.bsp import Costs
from clusterviz.partition.screen import (
    CostMap,
    RankGroups,
    ScreenPartition,
    ScreenTree,
    adapt,
    brick_rects,
    build_cuts,
    carried,
    cost_map_of_rects,
    interleaved_tiles,
    pattern_tiles,
    tile_queue,
    visible_bricks,
)
from clusterviz.plan.plan import Plan, shows_more
from clusterviz.report.statistics import RankFrame

STATIC = ("interleaved", "pattern", "scheduled")
"""Strategies by which any group may have to draw any brick, so that bricks need not follow the tiles."""
UNEVEN = 1.02  # imbalance of a group, relative to the best possible, up to which its bricks stay
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class TileSettings:
    """Settings of the tiles."""

    strategy: str  # value of `cluster.tiling` other than auto
    side: int  # of a tile, in pixels
    repetitions: int  # of the pattern


class Tiling:
    """Tile strategy, with its state from frame to frame; the same on every rank.

    Parameters
    ----------
    settings : of the tiles
    weights : number of ranks of each group
    """

    def __init__(self, settings: TileSettings, weights: tuple[int, ...]) -> None:
        self.settings, self._weights = settings, weights
        self._tree: ScreenTree | None = None
        self._before: ScreenTree | None = None
        self._expected: CostMap | None = None
        self._last: CostMap | None = None

    @property
    def is_static(self) -> bool:
        """True if any group may have to draw any brick."""
        return self.settings.strategy in STATIC

    def partition(self, plan: Plan) -> ScreenPartition:
        """Return the tiles of each group in a frame; with a queue, from which they are taken, the whole picture."""
        name, side, groups = self.settings.strategy, self.settings.side, len(self._weights)
        if name == "scheduled":
            return ScreenPartition(plan.view.size, ((Rect(0, 0, *plan.view.size),),) * groups)
        if name == "interleaved":
            return interleaved_tiles(plan.view.size, groups, side)
        if name == "pattern":
            z, y, x = plan.layout.shape_zyx
            return pattern_tiles(plan.view, (x - 1.0, y - 1.0, z - 1.0), groups, side, self.settings.repetitions)
        if self._tree is None or self._tree.size != plan.view.size:
            self._tree, self._before = build_cuts(expected_map(plan), self._weights), None
            self._expected = self._last = None
        if name == "temporal":
            expected = expected_map(plan)
            if self._last is not None and self._expected is not None:
                self._before = self._tree
                self._tree = adapt(self._tree, carried(self._last, self._expected, expected))
            self._expected, self._last = expected, None
        return self._tree.partition()

    def queue(self, plan: Plan) -> tuple[Rect, ...]:
        """Return the tiles of a frame in the order in which they are taken."""
        return tile_queue(expected_map(plan), self.settings.side)

    def learn(self, cost: CostMap) -> None:
        """Learn from the cost of the last frame, or from a pre-pass of this one."""
        if self._tree is not None and self._tree.size == cost.size and cost.cost.any():
            if self.settings.strategy == "temporal":
                self._last = cost
                return
            self._before = self._tree
            self._tree = build_cuts(cost, self._weights)

    def step_back(self) -> bool:
        """Return to the tiles before the last change; False if there are none."""
        if self._before is None:
            return False
        self._tree, self._before = self._before, None
        return True


def expected_map(plan: Plan) -> CostMap:
    """Return the expected cost of parts of the screen: samples of bricks, within their rectangles."""
    bricks, rects = brick_rects(plan)
    return cost_map_of_rects(plan.view.size, rects, expected_samples(plan)[tuple(bricks.T)])


class SortFirst:
    """Distribution of sort-first and hybrid.

    Parameters
    ----------
    groups : ranks of each group
    settings : of the tiles
    budget : memory of a rank for bricks, with a limit
    several : True if more than one frame may come; then bricks are kept

    Attributes
    ----------
    groups : ranks of each group
    tiling : tile strategy
    """

    def __init__(self, groups: RankGroups, settings: TileSettings, budget: MemoryBudget, several: bool) -> None:
        self.groups, self._several = groups, several
        assert budget.limit_bytes is not None, "a shared screen needs a memory limit"
        self._budget, self._brick_bytes, self._limit_bytes = budget, 0, budget.limit_bytes
        self.tiling = Tiling(settings, tuple(map(len, groups)))
        self._trees: list[BspTree] = []
        self._owners: list[Owners] = []
        self._models: list[Costs] = []
        self._measured: Measured | None = None
        self._assigned: Costs | None = None
        self._seen: list[Bools] = []
        self._shown: Bools = np.zeros((1, 1, 1), bool)
        self._held: Bools | None = None

    @property
    def mode(self) -> Mode:
        """Mode of compositing: sort-first if each group is a single rank."""
        return "sort-first" if max(map(len, self.groups)) == 1 else "hybrid"

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """Return the pieces of a frame, group by group; those of a group front to back in each of its tiles.

        Raises InputError if the bricks in a rank's tiles do not fit into its memory.
        """
        self._shown, self._brick_bytes = plan.cost > 0, int(self._budget.brick_bytes(plan).max())
        partition = self._assign_groups(plan)
        # If bricks do not fit, the tiles of the last frame may.
        if self._largest(self._seen) > self._limit_bytes and self.tiling.step_back():
            partition = self._assign_groups(plan)
        if plan.refraction is None:
            self._check_memory()
        else:  # bricks that do not fit are loaded in passes
            check_passes(plan, self._budget.brick_bytes(plan), self._limit_bytes)
        return self.pieces(plan, partition)

    def pieces(self, plan: Plan, partition: ScreenPartition) -> tuple[Piece, ...]:
        """Return the pieces of any partition of the screen, by the owners of the last assignment."""
        found: list[Piece] = []
        for members, owners, seen, tiles in zip(self.groups, self._owners, self._seen, partition.rects, strict=True):
            own = []
            for piece in _pieces(plan, owners, seen):
                shown = self._shown[piece.box.slices]
                # Bricks that are not visible do not divide a piece.
                is_box = piece.bricks is None or bool(np.all(piece.bricks == shown))
                own.append(replace(piece, rank=members[piece.rank], bricks=None if is_box else piece.bricks))
            found += [replace(piece, rect=tile) for tile in tiles for piece in own]
        return tuple(found)

    def holds(self, rank: int) -> frozenset[Index]:
        """Return a rank's bricks in its tiles; with several frames all its visible bricks, if all ranks can hold that.

        Bricks that it held before stay while they fit, since they may be needed again.
        """
        group = next(number for number, members in enumerate(self.groups) if rank in members)
        mine = self._owners[group].owner == self.groups[group].index(rank)
        held = mine & self._seen[group]
        if self._several and self._largest([self._shown] * len(self.groups)) <= self._limit_bytes:
            held = mine & self._shown
        if self._held is not None:
            old = np.argwhere(self._held & self._shown & ~held)
            held[tuple(old[: self._limit_bytes // max(1, self._brick_bytes) - int(held.sum())].T)] = True
        self._held = held
        return frozenset((z, y, x) for z, y, x in np.argwhere(held).tolist())

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Learn the cost of bricks from the samples of each group's ranks; `follow` learns the cost of tiles."""
        for members, owners, model in zip(self.groups, self._owners, self._models, strict=False):
            if len(members) > 1 and self._measured is not None:
                samples = [costs[rank].samples - costs[rank].samples_estimate for rank in members]
                self._measured = measure(self._measured, model, owners, np.array(samples, np.float64))

    def follow(self, cost: CostMap) -> None:
        """Learn the cost of tiles from the last frame, or from a pre-pass of this one."""
        self.tiling.learn(cost)

    def _assign_groups(self, plan: Plan) -> ScreenPartition:
        partition = self.tiling.partition(plan)
        # Rays that bend may meet any brick.
        whole = self.tiling.is_static or plan.refraction is not None
        self._seen = [self._shown if whole else visible_bricks(plan, each) for each in partition.rects]
        if self.tiling.is_static or max(map(len, self.groups)) == 1:
            self._assign_statically(plan)
        else:
            self._assign_by_cost(plan, partition)
        return partition

    def _assign_statically(self, plan: Plan) -> None:
        """Build one tree for each group; recomputed when an unassigned brick becomes visible."""
        if self._assigned is None or (self.tiling.is_static and shows_more(plan, self._assigned)):
            self._assigned = plan.cost
            self._owners = [owners_of(build_tree(plan.cost, len(members))) for members in self.groups]

    def _assign_by_cost(self, plan: Plan, partition: ScreenPartition) -> None:
        """Assign the bricks of each group by their expected cost within its tiles."""
        self._measured = self._measured or unmeasured(plan.layout.counts_zyx)
        self._models = []
        for seen, tiles in zip(self._seen, partition.rects, strict=True):
            visible = replace(plan, cost=np.where(seen, plan.cost, 0.0))
            models = [expected_samples(visible, tile) for tile in tiles]
            self._models.append(np.sum(models, axis=0) if models else np.zeros_like(plan.cost))
        costs = [predict(self._measured, *each) for each in zip(self._models, self._seen, strict=True)]
        self._trees = self._trees or [
            search_tree(cost, len(each)) for cost, each in zip(costs, self.groups, strict=True)
        ]
        before = self._owners or [owners_of(tree) for tree in self._trees]
        found = [self._assign_group(plan, *each) for each in zip(costs, self._seen, self._trees, before, strict=True)]
        self._trees, self._owners = [tree for tree, _ in found], [owners for _, owners in found]

    def _assign_group(
        self, plan: Plan, cost: Costs, seen: Bools, tree: BspTree, before: Owners
    ) -> tuple[BspTree, Owners]:
        """Assign the bricks of one group: of the most even candidates the one that moves fewest bricks."""
        ranks = before.ranks
        if ranks == 1 or not cost.any() or self._is_even(plan, cost, seen, before):
            return tree, before
        options = [
            (found, owners)
            for found, owners in _options(tree, before, cost, plan)
            if _is_ordered(plan, owners, seen) and self._fits(owners, seen)
        ]
        if not options:
            # A tree by the number of bricks needs the least memory.
            tree = build_tree(seen.astype(np.float64), ranks)
            return tree, owners_of(tree)
        least = min(float(owners.loads(cost).max()) for _, owners in options)
        return next(option for option in options if option[1].loads(cost).max() <= UNEVEN * least)

    def _is_even(self, plan: Plan, cost: Costs, seen: Bools, owners: Owners) -> bool:
        even = owners.imbalance(cost) <= UNEVEN
        return even and _is_ordered(plan, owners, seen) and self._fits(owners, seen)

    def _fits(self, owners: Owners, bricks: Bools) -> bool:
        return int(owners.loads(bricks.astype(np.float64)).max()) * self._brick_bytes <= self._limit_bytes

    def _check_memory(self) -> None:
        """Refuse tiles whose bricks do not fit into a rank's memory, before anything is loaded."""
        most = self._largest(self._seen)
        if most <= self._limit_bytes:
            return
        ranks = sum(map(len, self.groups))
        text = f"the tiles of a rank show {most} bytes of bricks, in {len(self.groups)} groups of {ranks} ranks"
        fewer = next(
            (n for n in range(len(self.groups) - 1, 1, -1) if self._shown_bytes() * n <= self._limit_bytes * ranks), 1
        )
        allowed = "mode: sort-last" if fewer == 1 else f"mode: hybrid with groups: {fewer} or fewer, sort-last"
        raise InputError(text, where="cluster.mode", found=f"{self._limit_bytes} bytes a rank", allowed=allowed)

    def _shown_bytes(self) -> int:
        return int(self._shown.sum()) * self._brick_bytes

    def _largest(self, bricks: Sequence[Bools]) -> int:
        """Return the most bytes of any rank, for a selection of bricks in each group."""
        loads = (owners.loads(some.astype(np.float64)).max() for owners, some in zip(self._owners, bricks, strict=True))
        return int(max(loads)) * self._brick_bytes


def _options(tree: BspTree, before: Owners, cost: Costs, plan: Plan) -> Iterator[tuple[BspTree, Owners]]:
    """Yield candidates for a group's owners: as before, by fronts, by planes; by fronts and planes of a new tree."""
    eye = ray_origin(plan.eye_in_bricks(), plan.view.forward)
    moved, other = move_planes(tree, cost), search_tree(cost, before.ranks)
    yield tree, before
    yield tree, front_owners(tree, cost, eye)
    yield moved, owners_of(moved)
    yield other, front_owners(other, cost, eye)
    yield other, owners_of(other)


def _pieces(plan: Plan, owners: Owners, seen: Bools) -> tuple[Piece, ...]:
    drawn = Owners(owners.ranks, np.where(seen, owners.owner, UNASSIGNED).astype(np.int32))
    return owner_pieces(drawn, plan.eye_in_bricks(), plan.view.forward)


def _is_ordered(plan: Plan, owners: Owners, seen: Bools) -> bool:
    """True if ranks have a visibility order: each rank of a group has a single image."""
    ranks = [piece.rank for piece in _pieces(plan, owners, seen)]
    return len(set(ranks)) == len(ranks)
