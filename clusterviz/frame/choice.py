"""Which distribution a scene gets: what its section `cluster` names, and what it leaves open."""

from __future__ import annotations

from clusterviz.composite.model.network import default_network
from clusterviz.errors import InputError
from clusterviz.frame.coherent import Coherent
from clusterviz.frame.distribution import Distribution
from clusterviz.frame.dynamic import Dynamic
from clusterviz.frame.interleaved import Interleaved
from clusterviz.frame.mode import choose_groups
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
        On every rank: more groups than ranks; several volumes whose bricks shall move.
    """
    cluster, ranks = scene.cluster, run.channel.size
    with run.alone("plan", "plan"):
        groups = _groups(cluster, ranks)
        if cluster.distribution == "dynamic" and len(scene.volumes) > 1:
            text, allowed = "moves bricks of one volume only", "auto, coherent, interleaved, replicated"
            raise InputError(text, where="cluster.distribution", found="dynamic", allowed=allowed)
    if opened is None or (groups == 1 and cluster.mode in ("auto", "sort-last")):
        return _of_data(cluster, ranks)
    with run.together("plan", "plan"):
        limit = _limit(run, cluster)
    if groups is None:
        groups = _fastest(run, opened, scene, limit) if several and _leaves_open(scene) else 1
        if groups == 1:
            return _of_data(cluster, ranks)
    settings = TileSettings(_strategy(cluster, several), cluster.tile, cluster.repetitions)
    return SharedScreen(rank_groups(ranks, groups), settings, limit, several)


def _limit(run: Run, cluster: Cluster) -> int:
    """Bytes of bricks that every rank may hold: as the scene says, or the smallest share of free memory of all."""
    if cluster.memory_limit is not None:
        return cluster.memory_limit
    mine = HELD_SHARE_OF_MEMORY * memory().available_bytes / run.channel.place().local_size
    return -run.channel.maximum(-int(mine))


def _leaves_open(scene: Scene) -> bool:
    """Whether nothing was said that belongs to sort-last, nor anything that is settled later."""
    cluster = scene.cluster
    said = (cluster.distribution, cluster.compositing, cluster.transport)
    return said == ("auto", "auto", "auto") and scene.quality.max_error is None


def _fastest(run: Run, opened: Opened, scene: Scene, limit: int) -> int:
    """The number of groups that should take least."""
    with run.together("plan", "plan"):
        nodes = run.channel.nodes()
        # The file may differ from node to node, and all must choose alike.
        network = run.channel.broadcast(default_network(len(nodes)))
    with run.alone("plan", "plan"):
        return choose_groups(opened.plan(scene), nodes, limit, network)


def _of_data(cluster: Cluster, ranks: int) -> Distribution:
    """The sort-last distribution that a scene names."""
    limit = cluster.memory_limit
    match cluster.distribution:
        case "interleaved":
            return Interleaved(ranks, limit)
        case "replicated":
            return Replicated(ranks, cluster.copies, limit)
        case "dynamic":
            return Dynamic(ranks, limit, cluster.migration_bytes)
        case _:
            return Coherent(ranks, limit)


def _groups(cluster: Cluster, ranks: int) -> int | None:
    """How many groups share the screen; None where the scene leaves it open."""
    if cluster.mode == "sort-first":
        return ranks
    if cluster.groups is not None:
        if cluster.groups > ranks:
            text = "more groups than ranks"
            raise InputError(text, where="cluster.groups", found=cluster.groups, allowed=f"1 … {ranks}")
        return cluster.groups
    if ranks == 1 or cluster.mode == "sort-last":
        return 1
    return ranks // 2 if cluster.mode == "hybrid" else None


def _strategy(cluster: Cluster, several: bool) -> str:
    """Frames that follow each other tell of each other; a single one is dealt as evenly as it can be unseen."""
    if cluster.tiling != "auto":
        return cluster.tiling
    return "temporal" if several else "interleaved"
