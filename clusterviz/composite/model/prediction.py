"""How long a composition should take: what an algorithm moves, put into the time model.

docs/time-model.md says what is in the model, and compares predictions with measured times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

from clusterviz.composite.model.communication import COMMUNICATION_COSTS, CommunicationCost, ImageStatistics
from clusterviz.composite.model.network import Network

Nodes = tuple[tuple[int, ...], ...]

# Inside a node, large messages pass through small buffers: the library's, of this order. Where ranks outnumber cores,
# sender and receiver take turns at each of them.
CHUNK_BYTES = 1 << 15


@dataclass(frozen=True)
class Placement:
    """Where it is composed.

    Attributes
    ----------
    all_nodes, most : nodes of the job, and ranks of the largest
    nodes : that have images; all that follows is of these
    ranks, strips : of the largest node, and of the smallest
    busy : ranks with images on the node that has most of them
    interleaved : whether images of one node lie on both sides of another's
    """

    all_nodes: int
    most: int
    nodes: int
    ranks: int
    strips: int
    busy: int
    interleaved: bool


def place_ranks(images: Sequence[int], nodes: Nodes) -> Placement:
    """Where images lie whose ranks are given from front to back, a rank for each."""
    node_of, most = _node_of(nodes), max(map(len, nodes))
    busy = Counter(node_of[rank] for rank in dict.fromkeys(images))
    if not busy:
        return Placement(len(nodes), most, 1, most, most, 0, False)
    sizes = [len(nodes[node]) for node in busy]
    runs = 1 + sum(a != b for a, b in pairwise(node_of[rank] for rank in images))
    return Placement(len(nodes), most, len(busy), max(sizes), min(sizes), max(busy.values()), runs > len(busy))


@lru_cache(maxsize=8)
def _node_of(nodes: Nodes) -> dict[int, int]:
    return {rank: number for number, ranks in enumerate(nodes) for rank in ranks}


def predict(algorithm: str, transport: str, stats: ImageStatistics, placement: Placement, network: Network) -> float:
    """Seconds from partial images until the picture is whole on the root, with raw pixels."""
    model = TimeModel(stats, placement, network)
    if stats.images == 0:
        return model.frame()
    if transport == "shared":
        return model.shared()
    if transport == "hierarchical":
        return model.hierarchical(algorithm)
    return model.messages(COMMUNICATION_COSTS[algorithm](stats))


class TimeModel:
    """The time model for one scene in one place.

    Ranks that share cores take turns, so what all ranks of a node do together, divided by its cores, is a limit beside
    what the busiest rank does; likewise the bytes of all ranks of a node share its link.
    """

    def __init__(self, stats: ImageStatistics, placement: Placement, network: Network) -> None:
        self._stats, self._placement, self._network = stats, placement, network
        self._cores = min(network.cores or placement.ranks, placement.ranks)
        self._ranks_per_core = placement.ranks / self._cores
        self._turn_seconds = (self._ranks_per_core - 1) * network.turn_seconds
        waiting = network.turn_seconds / CHUNK_BYTES if self._ranks_per_core > 1 else 0.0
        self._node_per_byte = network.node_seconds_per_byte + waiting
        self._blend_seconds = (
            network.seconds_per_pixel if stats.bytes_per_pixel == 4 else network.seconds_per_float_pixel
        )
        self._copy_seconds = network.copy_seconds_per_byte * stats.bytes_per_pixel
        # The share of what a rank sends that leaves its node.
        alone = 1 - (placement.busy - 1) / max(stats.images - 1, 1)
        self._off_node = alone if placement.nodes > 1 else 0.0

    def frame(self) -> float:
        """What every composition costs, whatever it moves."""
        return self._network.frame_seconds * self._ranks_per_core

    def messages(self, cost: CommunicationCost) -> float:
        """The algorithm, then the final gather."""
        network, size, nodes = self._network, self._stats.bytes_per_pixel, self._placement.nodes
        message, _, latency = self._link(self._off_node)
        pixel = self._blend_seconds + (1 - self._off_node) * size * self._node_per_byte
        busiest = cost.messages * message + cost.pixels * pixel
        everybody = (cost.messages_all * message + cost.pixels_all * pixel) / (self._cores * nodes)
        link = self._off_node * max(cost.pixels, cost.pixels_all / nodes) * size * network.seconds_per_byte
        return self.frame() + cost.rounds * latency + max(busiest, everybody) + link + self._gather(cost)

    def _link(self, away: float) -> tuple[float, float, float]:
        """Seconds of a message, of a byte, and of a round, of which such a share leaves the node."""
        network, near = self._network, 1 - away
        message = away * network.overhead_seconds + near * network.node_overhead_seconds + network.message_seconds
        per_byte = away * network.seconds_per_byte + near * self._node_per_byte
        latency = network.latency_seconds if away else network.node_latency_seconds
        return message, per_byte, latency + self._turn_seconds

    def _gather(self, cost: CommunicationCost) -> float:
        """The root receives the pieces of all others, one after the other."""
        if not cost.pieces:
            return 0.0
        message, per_byte, latency = self._link(1 - 1 / self._placement.nodes)
        # A piece is put in its place, not merged: this program does half as much for it as for another message.
        message -= self._network.message_seconds / 2
        return latency + cost.pieces * message + cost.gathered * self._stats.bytes_per_pixel * per_byte

    def shared(self) -> float:
        """Every rank blends a strip of all images where they lie."""
        return self.frame() + self._synchronize() + self._blend_strips(self._stats.images)

    def _synchronize(self) -> float:
        """Keeping a node in step twice, and the one merge of each rank, which costs this program as in a message."""
        network = self._network
        return 2 * (network.barrier_seconds + self._turn_seconds) + network.message_seconds * self._ranks_per_core

    def _blend_strips(self, images: float) -> float:
        """Blending so many images that lie in the window already, and writing the result, by all cores of a node."""
        pixels = self._stats.pixels
        return (images * self._stats.cover * pixels * self._blend_seconds + pixels * self._copy_seconds) / self._cores

    def hierarchical(self, algorithm: str) -> float:
        """Strips are blended on each node, then composed among the nodes, all strips at once."""
        stats, placement, network = self._stats, self._placement, self._network
        images = max(1.0, stats.images / placement.nodes)
        cover = stats.union(images)
        between = replace(stats, images=placement.nodes, cover=cover, largest=max(stats.largest, cover))
        cost = COMMUNICATION_COSTS[algorithm](between)
        cores = min(self._cores, placement.strips)
        message, _, latency = self._link(1.0)
        pixel = stats.bytes_per_pixel * network.seconds_per_byte + self._blend_seconds / cores
        exchange = cost.rounds * latency + cost.messages * message * placement.strips / cores + cost.pixels * pixel
        pieces = placement.nodes * placement.strips - 1
        gather = self._gather(replace(cost, pieces=pieces if cost.pieces else 0))
        return self.frame() + self._synchronize() + self._blend_strips(images) + exchange + gather
