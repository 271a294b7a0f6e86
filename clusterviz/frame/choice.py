"""Which distribution a scene gets: what its section `cluster` names, and what it leaves open."""

from __future__ import annotations

from clusterviz.composite.model.network import default_network
from clusterviz.errors import InputError
from clusterviz.frame.coherent import Coherent
from clusterviz.frame.distribution import Distribution
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.dynamic import Dynamic
from clusterviz.frame.interleaved import Interleaved
from clusterviz.frame.mode import candidates, choose, forecast, held_bytes
from clusterviz.frame.opening import HELD_SHARE_OF_MEMORY
from clusterviz.frame.prepass import sound
from clusterviz.frame.replicated import Replicated
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.shared_screen import SharedScreen
from clusterviz.frame.tiling import TileSettings
from clusterviz.partition.screen import rank_groups
from clusterviz.report.machine import memory
from clusterviz.report.sharing import Forecast, Sharing
from clusterviz.scene.values import Cluster, Scene


def choose_distribution(
    run: Run, opened: Opened | None, scene: Scene, several: bool, drawing: Drawing
) -> tuple[Distribution, tuple[Forecast, ...]]:
    """Who draws what in all frames of a loop; collective.

    Parameters
    ----------
    scene : completed
    several : whether more than one frame may come
    drawing : for a pre-pass, where one is needed; it keeps the bricks

    Returns
    -------
    distribution : the same on every rank
    forecasts : what it was chosen by; none where the scene left nothing open

    Raises
    ------
    InputError
        On every rank: more groups than ranks; several volumes whose bricks shall move.
    """
    cluster, ranks = scene.cluster, run.channel.size
    with run.alone("plan", "plan"):
        among = _groups(scene, ranks, several)
        if cluster.distribution == "dynamic" and len(scene.volumes) > 1:
            text, allowed = "moves bricks of one volume only", "auto, coherent, interleaved, replicated"
            raise InputError(text, where="cluster.distribution", found="dynamic", allowed=allowed)
    if opened is None or (among == [1] and cluster.mode in ("auto", "sort-last")):
        return _of_data(cluster, ranks), ()
    with run.together("plan", "plan"):
        limit = _limit(run, cluster)
    groups, forecasts = _fastest(run, opened, scene, drawing, among, limit) if len(among) > 1 else (among[0], ())
    if groups == 1 and cluster.mode == "auto":
        return _of_data(cluster, ranks), forecasts
    settings = TileSettings(_strategy(cluster, several), cluster.tile, cluster.repetitions)
    return SharedScreen(rank_groups(ranks, groups), settings, limit, several), forecasts


def sharing_of(distribution: Distribution, forecasts: tuple[Forecast, ...]) -> Sharing:
    """What was chosen, and by what."""
    if isinstance(distribution, SharedScreen):
        return Sharing(distribution.mode, len(distribution.groups), forecasts)
    return Sharing("sort-last", 1, forecasts)


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
    settled = scene.quality.max_error is None and not scene.quality.leaping
    return said == ("auto", "auto", "auto") and settled


def _fastest(
    run: Run, opened: Opened, scene: Scene, drawing: Drawing, among: list[int], limit: int
) -> tuple[int, tuple[Forecast, ...]]:
    """Of these numbers of groups, the one that should take least; rank 0 decides, so that all do alike."""
    with run.together("plan", "plan"):
        nodes = run.channel.nodes()
    with run.alone("plan", "plan"):
        plan, ranks = opened.plan(scene), run.channel.size
        fitting = [groups for groups in among if held_bytes(plan, ranks, groups) <= limit]
    if len(fitting) < 2 or not plan.cost.any():
        return (fitting or among)[0], ()
    sounding = sound(run, drawing, opened, scene, plan)
    with run.alone("plan", "choose"):
        found: tuple[Forecast, ...] = ()
        if sounding is not None:
            network = default_network(len(nodes))
            found = tuple(forecast(plan, nodes, groups, network, sounding) for groups in fitting)
    with run.together("plan", "choose"):
        found = run.channel.broadcast(found)
    return choose(found), found


def _of_data(cluster: Cluster, ranks: int) -> Distribution:
    """The sort-last distribution that a scene names."""
    limit = cluster.memory_limit
    match cluster.distribution:
        case "interleaved":
            return Interleaved(ranks, limit)
        case "replicated":
            return Replicated(ranks, cluster.copies, limit)
        case "dynamic":
            return Dynamic(ranks, limit, cluster.migration_bytes, cluster.migration_share)
        case _:
            return Coherent(ranks, limit)


def _groups(scene: Scene, ranks: int, several: bool) -> list[int]:
    """How many groups may share the screen, ascending; more than one number where the scene leaves it open."""
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


def _strategy(cluster: Cluster, several: bool) -> str:
    """Frames that follow each other tell of each other; a single one is dealt as evenly as it can be unseen."""
    if cluster.tiling != "auto":
        return cluster.tiling
    return "temporal" if several else "interleaved"
