"""Predicted time of compositing: the communication cost of an algorithm in the time model.

docs/concepts/time-model.md describes the model; docs/measurements/compositing.md compares it with measured times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

from clusterviz.composite.model.communication import CommunicationCost, ImageStatistics, communication_cost
from clusterviz.composite.model.network import Network

Nodes = tuple[tuple[int, ...], ...]

# Inside a node, MPI copies large messages through buffers of about this size. If ranks outnumber cores, sender and
# receiver take turns at each of them.
CHUNK_BYTES = 1 << 15


@dataclass(frozen=True)
class Placement:
    """Placement of the images on nodes."""

    # nodes of the job, and ranks of the largest
    all_nodes: int
    most: int
    nodes: int  # nodes that have images; all below refers to these
    # ranks of the largest node, and of the smallest
    ranks: int
    strips: int
    busy: int  # ranks with images on the node with most of them
    interleaved: bool  # whether images of one node lie on both sides of another's


def place_ranks(images: Sequence[int], nodes: Nodes) -> Placement:
    """Return the placement of images, given the rank of each from front to back."""
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
    """Return the seconds from partial images to the complete picture on the root, with raw pixels."""
    model = TimeModel(stats, placement, network)
    if stats.images == 0:
        return model.frame()
    if transport == "shared":
        return model.shared()
    if transport == "hierarchical":
        return model.hierarchical(algorithm)
    return model.messages(communication_cost(algorithm, stats))


class TimeModel:
    """Time model for one set of images and their placement.

    Ranks that share cores take turns. The time is therefore at least that of the busiest rank, and that of all ranks of
    a node divided by its cores. The bytes of all ranks of a node share its link.
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
        # Fraction of a rank's messages that leave its node.
        alone = 1 - (placement.busy - 1) / max(stats.images - 1, 1)
        self._off_node = alone if placement.nodes > 1 else 0.0

    def frame(self) -> float:
        """Return the constant cost of a frame."""
        return self._network.frame_seconds * self._ranks_per_core

    def messages(self, cost: CommunicationCost) -> float:
        """Return the time of the algorithm and the final gather."""
        network, size, nodes = self._network, self._stats.bytes_per_pixel, self._placement.nodes
        message, _, latency = self._link(self._off_node)
        pixel = self._blend_seconds + (1 - self._off_node) * size * self._node_per_byte
        busiest = cost.messages * message + cost.pixels * pixel
        everybody = (cost.messages_all * message + cost.pixels_all * pixel) / (self._cores * nodes)
        link = self._off_node * max(cost.pixels, cost.pixels_all / nodes) * size * network.seconds_per_byte
        return self.frame() + cost.rounds * latency + max(busiest, everybody) + link + self._gather(cost)

    def _link(self, away: float) -> tuple[float, float, float]:
        """Return seconds per message, byte and round, if the fraction `away` leaves the node."""
        network, near = self._network, 1 - away
        message = away * network.overhead_seconds + near * network.node_overhead_seconds + network.message_seconds
        per_byte = away * network.seconds_per_byte + near * self._node_per_byte
        latency = network.latency_seconds if away else network.node_latency_seconds
        return message, per_byte, latency + self._turn_seconds

    def _gather(self, cost: CommunicationCost) -> float:
        """Return the time of the final gather: the root receives the pieces of all others in sequence."""
        if not cost.pieces:
            return 0.0
        message, per_byte, latency = self._link(1 - 1 / self._placement.nodes)
        # A piece is copied, not merged: half of this program's cost of other messages.
        message -= self._network.message_seconds / 2
        return latency + cost.pieces * message + cost.gathered * self._stats.bytes_per_pixel * per_byte

    def shared(self) -> float:
        """Return the time of the shared transport."""
        return self.frame() + self._synchronize() + self._blend_strips(self._stats.images)

    def _synchronize(self) -> float:
        """Return the time of two barriers in a node, and of this program's cost of one merge per rank."""
        network = self._network
        return 2 * (network.barrier_seconds + self._turn_seconds) + network.message_seconds * self._ranks_per_core

    def _blend_strips(self, images: float) -> float:
        """Return the time in which all cores of a node blend `images` images in shared memory and write the result."""
        pixels = self._stats.pixels
        return (images * self._stats.cover * pixels * self._blend_seconds + pixels * self._copy_seconds) / self._cores

    def hierarchical(self, algorithm: str) -> float:
        """Return the time of the hierarchical transport."""
        stats, placement, network = self._stats, self._placement, self._network
        images = max(1.0, stats.images / placement.nodes)
        cover = stats.union(images)
        between = replace(stats, images=placement.nodes, cover=cover, largest=max(stats.largest, cover))
        cost = communication_cost(algorithm, between)
        cores = min(self._cores, placement.strips)
        message, _, latency = self._link(1.0)
        pixel = stats.bytes_per_pixel * network.seconds_per_byte + self._blend_seconds / cores
        exchange = cost.rounds * latency + cost.messages * message * placement.strips / cores + cost.pixels * pixel
        pieces = placement.nodes * placement.strips - 1
        gather = self._gather(replace(cost, pieces=pieces if cost.pieces else 0))
        return self.frame() + self._synchronize() + self._blend_strips(images) + exchange + gather
