"""Binary space partition of the screen: cuts along rows and columns, one rectangle per group, even in cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clusterviz.image.partial import Rect
from clusterviz.partition.screen.cost_map import CostMap, Costs
from clusterviz.partition.screen.tiles import ScreenPartition, Size

LONG_SIDE = 1.05  # a cut across the short side has to be better than one across the long side by this factor


@dataclass(frozen=True)
class Cut:
    """`low` has the pixels before `at` along an axis (0: rows, 1: columns), `high` the others."""

    axis: int
    at: int
    low: ScreenNode
    high: ScreenNode


ScreenNode = int | Cut
"""A group, or a cut between some groups and others."""


@dataclass(frozen=True)
class ScreenTree:
    """The screen, cut for groups."""

    size: Size  # (width, height) of the picture
    weights: tuple[int, ...]  # which share of the cost each group is to get: its number of ranks
    root: ScreenNode  # groups in order, the low side first

    def rects(self) -> tuple[Rect, ...]:
        """The rectangle of each group, some perhaps empty; all together hold every pixel once."""
        found: dict[int, Rect] = {}
        _collect(self.root, Rect(0, 0, *self.size), found)
        return tuple(found[group] for group in range(len(self.weights)))

    def partition(self) -> ScreenPartition:
        """The same for those who draw."""
        return ScreenPartition(self.size, tuple((rect,) if rect.pixels else () for rect in self.rects()))

    def busiest(self, cost: CostMap) -> float:
        """The largest cost of a group for each of its ranks."""
        rects = zip(self.rects(), self.weights, strict=True)
        return max(cost.total(rect) / weight for rect, weight in rects)


def build_cuts(cost: CostMap, weights: tuple[int, ...]) -> ScreenTree:
    """Halve the groups and the cost with them, from the whole screen down.

    Each cut is where the dearer side has least for each of its ranks, across the longer side of what costs something
    unless the other is better by more than `LONG_SIDE`; in the middle of where it does not matter.

    Reference: B. Moloney, D. Weiskopf, T. Möller, M. Strengert: Scalable sort-first parallel direct volume rendering
    with dynamic load balancing, EGPGV 2007.
    """
    return ScreenTree(cost.size, weights, _grow(cost, Rect(0, 0, *cost.size), weights, 0))


def best_cut(profile: Costs, begin: int, share: float) -> tuple[float, int]:
    """Where an interval of pixels is best cut: the cost for each unit of weight on the dearer side, and the pixel.

    `profile`: float64 (n + 1,), the cost before each pixel, from 0; `begin`: the interval's first pixel; `share`: of
    the weight, on the low side, between 0 and 1.
    """
    end, total = begin + len(profile) - 1, float(profile[-1])
    places = np.arange(begin + 1, end)
    if len(places) == 0:
        return total / share, end
    below = profile[places - begin]
    load = np.maximum(below / share, (total - below) / (1 - share))
    least = float(load.min())
    good = np.flatnonzero(load <= least * (1 + 1e-12))
    return least, int(places[good[len(good) // 2]])


def halves(rect: Rect, axis: int, at: int) -> tuple[Rect, Rect]:
    """A rectangle before and behind a cut, which may lie outside of it."""
    if axis == 0:
        at = min(max(at, rect.y_begin), rect.y_end)
        return Rect(rect.x_begin, rect.y_begin, rect.x_end, at), Rect(rect.x_begin, at, rect.x_end, rect.y_end)
    at = min(max(at, rect.x_begin), rect.x_end)
    return Rect(rect.x_begin, rect.y_begin, at, rect.y_end), Rect(at, rect.y_begin, rect.x_end, rect.y_end)


def profile_of(cost: CostMap, rect: Rect, axis: int) -> Costs:
    """The cost before each pixel; pixels themselves count where nothing costs anything."""
    profile = cost.profile(rect, axis)
    return profile if profile[-1] > 0 else np.arange(len(profile), dtype=np.float64)


def _grow(cost: CostMap, rect: Rect, weights: tuple[int, ...], first: int) -> ScreenNode:
    if len(weights) == 1:
        return first
    # Groups that make up half the weight, at least one on each side.
    middle = int(np.argmin(np.abs(np.cumsum(weights)[:-1] - sum(weights) / 2))) + 1
    share = sum(weights[:middle]) / sum(weights)
    profiles = [profile_of(cost, rect, axis) for axis in (0, 1)]
    corner = (rect.y_begin, rect.x_begin)
    loads = [best_cut(profile, begin, share) for profile, begin in zip(profiles, corner, strict=True)]
    extents = [_extent(profile) for profile in profiles]
    long = int(extents[1] >= extents[0])
    axis = 1 - long if loads[1 - long][0] * LONG_SIDE < loads[long][0] else long
    at = loads[axis][1]
    low, high = halves(rect, axis, at)
    return Cut(axis, at, _grow(cost, low, weights[:middle], first), _grow(cost, high, weights[middle:], first + middle))


def _extent(profile: Costs) -> int:
    inside = np.flatnonzero(np.diff(profile) > 0)
    return int(inside[-1] - inside[0]) if len(inside) else 0


def _collect(node: ScreenNode, rect: Rect, found: dict[int, Rect]) -> None:
    if isinstance(node, Cut):
        low, high = halves(rect, node.axis, node.at)
        _collect(node.low, low, found)
        _collect(node.high, high, found)
    else:
        found[node] = rect
