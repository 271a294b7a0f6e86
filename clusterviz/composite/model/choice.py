"""What `auto` means: the algorithm and the transport with the shortest predicted time, the same on every rank.

Only numbers that every rank has go in (the footprints, the nodes, the network file of the root), so nobody has to ask.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NoReturn

from clusterviz.composite.footprints import Footprints
from clusterviz.composite.model.moves import Scene
from clusterviz.composite.model.network import Network
from clusterviz.composite.model.prediction import Places, place_ranks, predict
from clusterviz.composite.schedules.algorithms import SEVERAL_IMAGES, candidates, check_algorithm
from clusterviz.errors import InputError

TRANSPORTS = ("messages", "shared", "hierarchical", "auto")
# A tree leaves most of its work to one rank, which nothing helps when it is disturbed; it has to win clearly.
HANDICAPS = {"tree": 1.5}


@dataclass(frozen=True)
class Wanted:
    """What the user asked for: names, each of which may be "auto"."""

    algorithm: str
    transport: str
    codec: str


@dataclass(frozen=True)
class Choice:
    """What runs.

    Attributes
    ----------
    algorithm, transport : never "auto"; the shared transport always is direct send, in place
    codec : as wanted; "auto" is decided for each message
    seconds_predicted : until the picture is whole on rank 0, all pixels sent raw
    """

    algorithm: str
    transport: str
    codec: str
    seconds_predicted: float


def choose(
    wanted: Wanted,
    footprints: Footprints,
    nodes: Sequence[Sequence[int]],
    network: Network,
    *,
    several: bool = False,
    window_possible: bool = True,
) -> Choice:
    """The fastest of what is possible and wanted; pure, so the same on every rank that gives the same.

    Parameters
    ----------
    nodes : the channel's ranks on each node
    several : whether images of other ranks lie between those of a rank
    window_possible : whether the ranks of a node can share memory

    Raises
    ------
    InputError
        Unknown names, or a combination that cannot be.
    """
    where = nodes if isinstance(nodes, tuple) else tuple(tuple(ranks) for ranks in nodes)
    places = place_ranks([layer.rank for layer in footprints.layers], where)
    return fastest(wanted, _summary(footprints), places, several, window_possible, network)


def _summary(footprints: Footprints) -> Scene:
    """The footprints in few numbers."""
    layers, size = footprints.layers, 4 * footprints.dtype.itemsize
    if not layers:
        return Scene(0, 0, 1.0, 1.0, size, True)
    covered = [layer.rect.pixels / footprints.canvas.pixels for layer in layers]
    ranks = len(footprints.order)
    front_is_root = footprints.order[0] == 0
    return Scene(ranks, footprints.canvas.pixels, sum(covered) / ranks, max(covered), size, front_is_root)


@lru_cache(maxsize=64)
def fastest(
    wanted: Wanted, scene: Scene, places: Places, several: bool, window_possible: bool, network: Network
) -> Choice:
    """The first of the fastest candidates, where a tree has a handicap."""
    found = []
    for transport in _transports(wanted, places, window_possible):
        across = transport == "hierarchical"
        mixed, count = (places.interleaved, places.nodes) if across else (several, scene.images)
        algorithms = ["direct-send"] if transport == "shared" else _algorithms(wanted.algorithm, count, mixed)
        for algorithm in algorithms:
            seconds = predict(algorithm, transport, scene, places, network)
            found.append(Choice(algorithm, transport, wanted.codec, seconds))
    return min(found, key=lambda choice: choice.seconds_predicted * HANDICAPS.get(choice.algorithm, 1.0))


def _transports(wanted: Wanted, places: Places, window_possible: bool) -> list[str]:
    """Of the transports that are possible, those that are wanted."""
    if wanted.transport not in TRANSPORTS:
        allowed = ", ".join(TRANSPORTS)
        raise InputError("unknown transport", where="cluster.transport", found=wanted.transport, allowed=allowed)
    if places.most == 1:
        # Ranks that share no node have nothing else, unless all of them are asked for what none can have.
        possible = ["messages"]
        alone = wanted.transport == "hierarchical" or (wanted.transport == "shared" and places.all_nodes == 1)
        return possible if wanted.transport in ("messages", "auto") or alone else _refuse(wanted, possible)
    possible = ["messages", "hierarchical"] if window_possible else ["messages"]
    if window_possible and places.all_nodes == 1:
        possible.insert(0, "shared")
    if wanted.transport != "auto":
        return [wanted.transport] if wanted.transport in possible else _refuse(wanted, possible)
    # Who names an algorithm wants to see it run, and on one node only messages do that.
    left_out = {"hierarchical"} if places.all_nodes == 1 else set()
    left_out |= {"shared"} if wanted.algorithm != "auto" else set()
    return [name for name in possible if name not in left_out]


def _refuse(wanted: Wanted, possible: list[str]) -> NoReturn:
    text = "the ranks cannot share memory as this transport needs it"
    raise InputError(text, where="cluster.transport", found=wanted.transport, allowed=", ".join([*possible, "auto"]))


def _algorithms(wanted: str, ranks: int, several: bool) -> list[str]:
    """The algorithms to choose from: the one that is wanted, or those that are the fastest somewhere.

    Where images of other ranks lie between those of a rank, direct send does what most others cannot.
    """
    if wanted != "auto":
        check_algorithm(wanted)
        return ["direct-send"] if several and wanted not in SEVERAL_IMAGES else [wanted]
    return ["direct-send"] if several else candidates(ranks)
