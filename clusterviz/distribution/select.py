"""Selection of the distribution by the section `cluster` of a scene."""

from __future__ import annotations

from dataclasses import replace

from clusterviz.distribution.coherent import Coherent
from clusterviz.distribution.contract import Distribution
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.distribution.sort_first import SortFirst, TileSettings
from clusterviz.errors import InputError
from clusterviz.partition.screen import rank_groups
from clusterviz.report.decisions import Forecast, Sharing
from clusterviz.scene.values import Cluster, Scene


def candidates(ranks: int) -> list[int]:
    """Return numbers of groups to compare, ascending: groups of about 1, 2, 3, 4, 6, 8, 12 … ranks, and one of all."""
    sizes = [size for power in range(ranks.bit_length()) for size in (2**power, 3 * 2**power) if size < ranks]
    return sorted({1, *(ranks // size for size in sizes), *(-(-ranks // size) for size in sizes)})


def groups_of(scene: Scene, ranks: int, several: bool) -> list[int]:
    """Return the allowed numbers of groups, ascending; a single one if the scene names it.

    Parameters
    ----------
    several : True if more than one frame may come

    Raises
    ------
    InputError
        More groups than ranks.
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

    Parameters
    ----------
    budget : memory of a rank for bricks; sort-last uses the limit of the scene instead of `limit_bytes`
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
    """Make the sort-last distribution that a scene names."""
    match cluster.distribution:
        case "interleaved":
            from clusterviz.distribution.interleaved import Interleaved

            return Interleaved(ranks, budget)
        case "replicated":
            from clusterviz.distribution.replicated import Replicated

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
