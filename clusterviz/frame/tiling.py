"""How the screen is shared in a frame: the strategy that the scene names, and what it remembers from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

from clusterviz.balance.expected import expected_samples
from clusterviz.image.region import Rect
from clusterviz.partition.screen import (
    CostMap,
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
)
from clusterviz.plan.plan import Plan

STATIC = ("interleaved", "pattern", "scheduled")
"""Strategies of which any group may have to draw anything, so that nothing has to follow the windows."""


@dataclass(frozen=True)
class TileSettings:
    """What a scene says of tiles.

    Attributes
    ----------
    strategy : a name of the scene's, not auto
    side : of a tile, in pixels
    repetitions : of the pattern
    """

    strategy: str
    side: int
    repetitions: int


class Tiling:
    """One strategy, from frame to frame; the same on every rank.

    Parameters
    ----------
    settings : which
    weights : the number of ranks of each group
    """

    def __init__(self, settings: TileSettings, weights: tuple[int, ...]) -> None:
        self.settings, self._weights = settings, weights
        self._tree: ScreenTree | None = None
        self._before: ScreenTree | None = None
        self._expected: CostMap | None = None
        self._last: CostMap | None = None

    @property
    def is_static(self) -> bool:
        """Whether any group may have to draw anything."""
        return self.settings.strategy in STATIC

    def mosaic(self, plan: Plan) -> ScreenPartition:
        """Who draws which part of a frame; where tiles are taken from a queue, who would without one."""
        name, side, groups = self.settings.strategy, self.settings.side, len(self._weights)
        if name in ("interleaved", "scheduled"):
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
        """The tiles of a frame in the order in which they are taken."""
        return tile_queue(expected_map(plan), self.settings.side)

    def learn(self, cost: CostMap) -> None:
        """What the last frame cost, or what a pre-pass says of this one."""
        if self._tree is not None and self._tree.size == cost.size and cost.cost.any():
            if self.settings.strategy == "temporal":
                self._last = cost
                return
            self._before = self._tree
            self._tree = build_cuts(cost, self._weights)

    def step_back(self) -> bool:
        """Go back to what was before the last lesson; whether there is such a thing."""
        if self._before is None:
            return False
        self._tree, self._before = self._before, None
        return True


def expected_map(plan: Plan) -> CostMap:
    """What parts of the screen should cost before anything was drawn: samples of bricks, where these are seen."""
    bricks, rects = brick_rects(plan)
    return cost_map_of_rects(plan.view.size, rects, expected_samples(plan)[tuple(bricks.T)])
