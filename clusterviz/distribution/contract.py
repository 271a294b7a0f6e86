"""Contract of distributions, which assign bricks to ranks, and the selection of one.

A distribution is kept from frame to frame. It uses only values that are equal on all ranks, so that all ranks reach the
same decisions without communication. What it needs beyond that, such as messages or pictures, is done by its hooks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol

from clusterviz.data.source import Index
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.distribution.sort_first import SortFirst, TileSettings
from clusterviz.distribution.static import Coherent, Interleaved, Replicated
from clusterviz.errors import InputError
from clusterviz.frame.run import Run
from clusterviz.frame.work import DrawnFrame, Mode, Planning, RankWork
from clusterviz.image.partial import Rect
from clusterviz.partition import Piece
from clusterviz.partition.screen import rank_groups
from clusterviz.plan.plan import Plan
from clusterviz.report.decisions import Forecast, Sharing
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.values import Cluster, Scene


class Distribution(Protocol):
    """Assignment of bricks to ranks, frame by frame."""

    @property
    def mode(self) -> Mode:
        """How ranks share a frame: sort-last, unless groups of them share the screen."""

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """Return the pieces of a frame, front to back; at each pixel, each visible brick is in exactly one."""

    def holds(self, rank: int) -> frozenset[Index]:
        """Return the bricks that a rank must keep after the last `assign`; it may drop all others."""

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Learn from the cost of a frame on each rank."""


class DistributionHooks(Protocol):
    """Hooks of a distribution in the frame loop, kept from frame to frame; every method is collective."""

    def prepare(self, run: Run, scene: Scene, plan: Plan) -> Planning[None]:
        """Prepare the assignment of a frame, by a pre-pass for example."""

    def before(self, run: Run, work: RankWork) -> Iterable[Rect] | None:
        """Begin the drawing of a frame whose bricks are loaded.

        Returns tiles in which this rank draws all its pieces, such as those of a work queue; None: the pieces'
        rectangles.
        """

    def counted(self, counts: RankFrame) -> RankFrame:
        """Add the hooks' own counts to those of a frame."""

    def after(self, run: Run, drawn: DrawnFrame, costs: Sequence[RankFrame]) -> None:
        """Use the costs of a drawn frame, one for each rank."""

    def close(self) -> None:
        """Free resources."""


def candidates(ranks: int) -> list[int]:
    """Return numbers of groups to compare, ascending: groups of about 1, 2, 3, 4, 6, 8, 12 … ranks, and one of all."""
    sizes = [size for power in range(ranks.bit_length()) for size in (2**power, 3 * 2**power) if size < ranks]
    return sorted({1, *(ranks // size for size in sizes), *(-(-ranks // size) for size in sizes)})


def groups_of(scene: Scene, ranks: int, several: bool) -> list[int]:
    """Return the allowed numbers of groups, ascending; a single one if the scene names it.

    `several`: True if more than one frame may come. Raises InputError for more groups than ranks.
    """
    cluster = scene.cluster
    if cluster.mode == "sort-first":
        return [ranks]
    if cluster.groups is not None:
        if cluster.groups > ranks:
            text = "more groups than ranks"
            raise InputError(text, where="cluster.groups", found=cluster.groups, allowed=f"1 … {ranks}")
        return [cluster.groups]
    if cluster.mode == "hybrid":
        return [groups for groups in candidates(ranks) if 1 < groups < ranks] or [1]
    return candidates(ranks) if cluster.mode == "auto" and several and _leaves_open(scene) else [1]


def distribution_of(cluster: Cluster, ranks: int, groups: int, budget: MemoryBudget, several: bool) -> Distribution:
    """Make the distribution of a scene for a number of groups that share the screen.

    `budget`: memory of a rank for bricks; sort-last uses the limit of the scene instead of `limit_bytes`.
    """
    if groups == 1 and cluster.mode in ("auto", "sort-last"):
        return _of_data(cluster, ranks, replace(budget, limit_bytes=cluster.memory_limit))
    settings = TileSettings(_strategy(cluster, several), cluster.tile, cluster.repetitions)
    return SortFirst(rank_groups(ranks, groups), settings, budget, several)


def sharing_of(distribution: Distribution, forecasts: tuple[Forecast, ...]) -> Sharing:
    """Return the mode and the number of groups of a distribution, with the forecasts that led to them."""
    if isinstance(distribution, SortFirst):
        return Sharing(distribution.mode, len(distribution.groups), forecasts)
    return Sharing("sort-last", 1, forecasts)


def _leaves_open(scene: Scene) -> bool:
    """True if the scene sets none of the options that belong to sort-last."""
    cluster = scene.cluster
    options = (cluster.distribution, cluster.compositing, cluster.transport)
    return options == ("auto", "auto", "auto") and not scene.quality.frame_coherence


def _of_data(cluster: Cluster, ranks: int, budget: MemoryBudget) -> Distribution:
    match cluster.distribution:
        case "interleaved":
            return Interleaved(ranks, budget)
        case "replicated":
            return Replicated(ranks, cluster.copies, budget)
        case "dynamic":
            from clusterviz.distribution.dynamic import Dynamic

            return Dynamic(ranks, budget, cluster.migration_bytes, cluster.migration_share)
        case _:
            return Coherent(ranks, budget)


def _strategy(cluster: Cluster, several: bool) -> str:
    """Return the tile strategy: for a single frame, whose cost is unknown, interleaved tiles are the most even."""
    if cluster.tiling != "auto":
        return cluster.tiling
    return "temporal" if several else "interleaved"
