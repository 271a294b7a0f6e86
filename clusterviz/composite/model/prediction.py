"""How long a composition should take: what an algorithm moves, put into the time model.

docs/time-model.md says what is in the model, and compares predictions with measured times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

from clusterviz.composite.model.moves import MOVES, Moves, Scene
from clusterviz.composite.model.network import Network

Nodes = tuple[tuple[int, ...], ...]

# Inside a node, large messages pass through small buffers: the library's, of this order. Where ranks outnumber cores,
# sender and receiver take turns at each of them.
CHUNK_BYTES = 1 << 15


@dataclass(frozen=True)
class Places:
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


def place_ranks(images: Sequence[int], nodes: Nodes) -> Places:
    """Where images lie whose ranks are given from front to back, a rank for each."""
    node_of, most = _node_of(nodes), max(map(len, nodes))
    busy = Counter(node_of[rank] for rank in dict.fromkeys(images))
    if not busy:
        return Places(len(nodes), most, 1, most, most, 0, False)
    sizes = [len(nodes[node]) for node in busy]
    runs = 1 + sum(a != b for a, b in pairwise(node_of[rank] for rank in images))
    return Places(len(nodes), most, len(busy), max(sizes), min(sizes), max(busy.values()), runs > len(busy))


@lru_cache(maxsize=8)
def _node_of(nodes: Nodes) -> dict[int, int]:
    return {rank: number for number, ranks in enumerate(nodes) for rank in ranks}


def predict(algorithm: str, transport: str, scene: Scene, places: Places, network: Network) -> float:
    """Seconds from partial images until the picture is whole on the root, with raw pixels."""
    clock = Clock(scene, places, network)
    if scene.images == 0:
        return clock.frame()
    if transport == "shared":
        return clock.shared()
    if transport == "hierarchical":
        return clock.hierarchical(algorithm)
    return clock.messages(MOVES[algorithm](scene))


class Clock:
    """The time model for one scene in one place.

    Ranks that share cores take turns, so what all ranks of a node do together, divided by its cores, is a limit beside
    what the busiest rank does; likewise the bytes of all ranks of a node share its link.
    """

    def __init__(self, scene: Scene, places: Places, network: Network) -> None:
        self._scene, self._places, self._network = scene, places, network
        self._cores = min(network.cores or places.ranks, places.ranks)
        self._crowd = places.ranks / self._cores
        self._turn = (self._crowd - 1) * network.turn_seconds
        waiting = network.turn_seconds / CHUNK_BYTES if self._crowd > 1 else 0.0
        self._node_per_byte = network.node_seconds_per_byte + waiting
        self._blend = network.seconds_per_pixel if scene.bytes_per_pixel == 4 else network.seconds_per_float_pixel
        self._copy = network.copy_seconds_per_byte * scene.bytes_per_pixel
        # The share of what a rank sends that leaves its node.
        alone = 1 - (places.busy - 1) / max(scene.images - 1, 1)
        self._away = alone if places.nodes > 1 else 0.0

    def frame(self) -> float:
        """What every composition costs, whatever it moves."""
        return self._network.frame_seconds * self._crowd

    def messages(self, moves: Moves) -> float:
        """The algorithm, then the final gather."""
        network, size, nodes = self._network, self._scene.bytes_per_pixel, self._places.nodes
        message, _, latency = self._link(self._away)
        pixel = self._blend + (1 - self._away) * size * self._node_per_byte
        busiest = moves.messages * message + moves.pixels * pixel
        everybody = (moves.messages_all * message + moves.pixels_all * pixel) / (self._cores * nodes)
        link = self._away * max(moves.pixels, moves.pixels_all / nodes) * size * network.seconds_per_byte
        return self.frame() + moves.rounds * latency + max(busiest, everybody) + link + self._gather(moves)

    def _link(self, away: float) -> tuple[float, float, float]:
        """Seconds of a message, of a byte, and of a round, of which such a share leaves the node."""
        network, near = self._network, 1 - away
        message = away * network.overhead_seconds + near * network.node_overhead_seconds + network.message_seconds
        per_byte = away * network.seconds_per_byte + near * self._node_per_byte
        latency = network.latency_seconds if away else network.node_latency_seconds
        return message, per_byte, latency + self._turn

    def _gather(self, moves: Moves) -> float:
        """The root receives the pieces of all others, one after the other."""
        if not moves.pieces:
            return 0.0
        message, per_byte, latency = self._link(1 - 1 / self._places.nodes)
        # A piece is put in its place, not merged: this program does half as much for it as for another message.
        message -= self._network.message_seconds / 2
        return latency + moves.pieces * message + moves.gathered * self._scene.bytes_per_pixel * per_byte

    def shared(self) -> float:
        """Every rank blends a strip of all images where they lie."""
        return self.frame() + self._step() + self._in_window(self._scene.images)

    def _step(self) -> float:
        """Keeping a node in step twice, and the one merge of each rank, which costs this program as in a message."""
        network = self._network
        return 2 * (network.barrier_seconds + self._turn) + network.message_seconds * self._crowd

    def _in_window(self, images: float) -> float:
        """Blending so many images that lie in the window already, and writing the result, by all cores of a node."""
        pixels = self._scene.pixels
        return (images * self._scene.cover * pixels * self._blend + pixels * self._copy) / self._cores

    def hierarchical(self, algorithm: str) -> float:
        """Strips are blended on each node, then composed among the nodes, all strips at once."""
        scene, places, network = self._scene, self._places, self._network
        images = max(1.0, scene.images / places.nodes)
        cover = scene.union(images)
        between = replace(scene, images=places.nodes, cover=cover, largest=max(scene.largest, cover))
        moves = MOVES[algorithm](between)
        cores = min(self._cores, places.strips)
        message, _, latency = self._link(1.0)
        pixel = scene.bytes_per_pixel * network.seconds_per_byte + self._blend / cores
        exchange = moves.rounds * latency + moves.messages * message * places.strips / cores + moves.pixels * pixel
        pieces = places.nodes * places.strips - 1
        gather = self._gather(replace(moves, pieces=pieces if moves.pieces else 0))
        return self.frame() + self._step() + self._in_window(images) + exchange + gather
