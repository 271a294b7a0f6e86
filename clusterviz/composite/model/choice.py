"""Automatic choice of the algorithm and the transport with the shortest predicted time, the same on every rank.

It depends only on values that every rank has: the footprints, the nodes, and the network file of the root.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NoReturn

from clusterviz.composite.footprints import Footprints
from clusterviz.composite.model.communication import COMMUNICATION_COSTS, ImageStatistics
from clusterviz.composite.model.network import Network
from clusterviz.composite.model.prediction import Placement, place_ranks, predict
from clusterviz.composite.schedules.algorithms import ALGORITHMS, SEVERAL_IMAGES, candidates, check_algorithm
from clusterviz.errors import InputError

TRANSPORTS = ("messages", "shared", "hierarchical", "auto")
# A tree gives most of its work to one rank, so a disturbance of that rank is not hidden; it has to win clearly.
HANDICAPS = {"tree": 1.5}


@dataclass(frozen=True)
class Request:
    """Requested names, each of which may be "auto"."""

    algorithm: str
    transport: str
    codec: str


@dataclass(frozen=True)
class Choice:
    # never "auto"; the shared transport always is direct send, in place
    algorithm: str
    transport: str
    codec: str  # as requested; "auto" is decided for each message
    seconds_predicted: float  # time until the picture is complete on rank 0, with raw pixels


def choose(request: Request, footprints: Footprints, nodes: Sequence[Sequence[int]], network: Network) -> Choice:
    """Return the fastest choice that is possible and requested; a pure function of its arguments.

    `nodes` are the ranks of the channel on each node. Unknown names and impossible combinations raise InputError.
    """
    where = nodes if isinstance(nodes, tuple) else tuple(tuple(ranks) for ranks in nodes)
    placement = place_ranks([layer.rank for layer in footprints.layers], where)
    return fastest(request, _summary(footprints), placement, footprints.interleaved, network)


def _summary(footprints: Footprints) -> ImageStatistics:
    layers, size = footprints.layers, 4 * footprints.dtype.itemsize
    if not layers:
        return ImageStatistics(0, 0, 1.0, 1.0, size, True)
    covered = [layer.rect.pixels / footprints.canvas.pixels for layer in layers]
    ranks = len(footprints.order)
    front_is_root = footprints.order[0] == 0
    return ImageStatistics(ranks, footprints.canvas.pixels, sum(covered) / ranks, max(covered), size, front_is_root)


@lru_cache(maxsize=64)
def fastest(
    request: Request, stats: ImageStatistics, placement: Placement, interleaved: bool, network: Network
) -> Choice:
    """Return the fastest candidate; a tree has a handicap."""
    found = []
    for transport in _transports(request, placement):
        across = transport == "hierarchical"
        mixed, count = (placement.interleaved, placement.nodes) if across else (interleaved, stats.images)
        algorithms = ["direct-send"] if transport == "shared" else _algorithms(request.algorithm, count, mixed)
        for algorithm in algorithms:
            seconds = predict(algorithm, transport, stats, placement, network)
            found.append(Choice(algorithm, transport, request.codec, seconds))
    return min(found, key=lambda choice: choice.seconds_predicted * HANDICAPS.get(choice.algorithm, 1.0))


def _transports(request: Request, placement: Placement) -> list[str]:
    if request.transport not in TRANSPORTS:
        allowed = ", ".join(TRANSPORTS)
        raise InputError("unknown transport", where="cluster.transport", found=request.transport, allowed=allowed)
    if placement.most == 1:
        # Ranks that share no node only have messages; a request for hierarchical, or for shared on one node, is met so.
        possible = ["messages"]
        alone = request.transport == "hierarchical" or (request.transport == "shared" and placement.all_nodes == 1)
        return possible if request.transport in ("messages", "auto") or alone else _refuse(request, possible)
    possible = ["shared", "messages", "hierarchical"] if placement.all_nodes == 1 else ["messages", "hierarchical"]
    if request.transport != "auto":
        return [request.transport] if request.transport in possible else _refuse(request, possible)
    # A named algorithm has to run, and on one node only messages run it.
    left_out = {"hierarchical"} if placement.all_nodes == 1 else set()
    left_out |= {"shared"} if request.algorithm != "auto" else set()
    return [name for name in possible if name not in left_out]


def _refuse(request: Request, possible: list[str]) -> NoReturn:
    text = "the ranks cannot share memory as this transport needs it"
    raise InputError(text, where="cluster.transport", found=request.transport, allowed=", ".join([*possible, "auto"]))


def _algorithms(request: str, ranks: int, interleaved: bool) -> list[str]:
    """Return the candidates: the requested algorithm, or those that are the fastest for some scenes.

    So may be one without a closed form, as nobody has compared it. Most algorithms cannot handle images of other ranks
    between those of a rank; direct send then replaces them.
    """
    if request != "auto":
        check_algorithm(request)
        return ["direct-send"] if interleaved and request not in SEVERAL_IMAGES else [request]
    counted = [name for name in ALGORITHMS if name not in COMMUNICATION_COSTS]
    return ["direct-send"] if interleaved else [*candidates(ranks), *counted]
