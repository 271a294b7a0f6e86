"""Which distribution a scene gets: what its section `cluster` names, and what it leaves open."""

from __future__ import annotations

from clusterviz.errors import InputError
from clusterviz.frame.coherent import Coherent
from clusterviz.frame.distribution import Distribution
from clusterviz.frame.interleaved import Interleaved
from clusterviz.frame.opening import HELD_SHARE_OF_MEMORY
from clusterviz.frame.replicated import Replicated
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.shared_screen import SharedScreen
from clusterviz.frame.tiling import TileSettings
from clusterviz.partition.screen import rank_groups
from clusterviz.report.machine import memory
from clusterviz.scene.values import Cluster, Scene


def choose_distribution(run: Run, opened: Opened | None, scene: Scene, several: bool) -> Distribution:
    """Who draws what in all frames of a loop; collective.

    Parameters
    ----------
    scene : completed
    several : whether more than one frame may come

    Raises
    ------
    InputError
        On every rank: more groups than ranks.
    """
    cluster, ranks = scene.cluster, run.channel.size
    with run.alone("plan", "plan"):
        groups = _groups(cluster, ranks)
    if opened is None or (groups == 1 and cluster.mode in ("auto", "sort-last")):
        return _of_data(cluster, ranks)
    limit = cluster.memory_limit
    if limit is None:
        with run.together("plan", "plan"):
            mine = HELD_SHARE_OF_MEMORY * memory().available_bytes / run.channel.place().local_size
            # The smallest of all ranks.
            limit = -run.channel.maximum(-int(mine))
    settings = TileSettings(_strategy(cluster, groups, ranks, several), cluster.tile, cluster.repetitions)
    return SharedScreen(rank_groups(ranks, groups), settings, limit, several)


def _of_data(cluster: Cluster, ranks: int) -> Distribution:
    """The sort-last distribution that a scene names."""
    limit = cluster.memory_limit
    match cluster.distribution:
        case "interleaved":
            return Interleaved(ranks, limit)
        case "replicated":
            return Replicated(ranks, cluster.copies, limit)
        case _:
            return Coherent(ranks, limit)


def _groups(cluster: Cluster, ranks: int) -> int:
    """How many groups share the screen."""
    if cluster.mode == "sort-first":
        return ranks
    if cluster.groups is not None:
        if cluster.groups > ranks:
            text = "more groups than ranks"
            raise InputError(text, where="cluster.groups", found=cluster.groups, allowed=f"1 … {ranks}")
        return cluster.groups
    return 1 if cluster.mode != "hybrid" else max(1, ranks // 2)


def _strategy(cluster: Cluster, groups: int, ranks: int, several: bool) -> str:
    """Frames that follow each other tell of each other; a single one is dealt as evenly as it can be unseen.

    In a hybrid the data of a group stay where they are only if its windows lie everywhere.
    """
    if cluster.tiling != "auto":
        return cluster.tiling
    return "temporal" if several and groups == ranks else "interleaved"
