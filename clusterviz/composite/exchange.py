"""Exchange engine: runs the traffic of any schedule over any channel.

In each stage all receives are posted before any send. Sends start in rotated order, so that no two ranks begin with the
same target. Messages are merged as they arrive. Bytes are rounded once per stage: keeping float32 between stages takes
twice the time (8 ranks, dense), and does not remove the error of the opacities that travel. The engine depends neither
on the algorithm nor on the merge operator.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec import Rows, open_message, unpack
from clusterviz.codec.contract import Bytes
from clusterviz.comm.channel import Channel
from clusterviz.composite.counters import PeerCounters, StageCounters
from clusterviz.composite.fragment import Fragment, Patch
from clusterviz.composite.gather import Pack
from clusterviz.composite.merging import RangeMerge
from clusterviz.composite.over.layers import Layer
from clusterviz.composite.traffic import Merge, Message, Part, StageTraffic
from clusterviz.errors import ClustervizError
from clusterviz.image.merge import Operator


@dataclass(frozen=True, eq=False)
class HeldZone:
    """Pixels of one zone: its first pixel number, and its fragments by depth of the layer."""

    begin: int
    fragments: Mapping[int, Fragment]


class ExchangeError(ClustervizError):
    """A stage of compositing failed; the text names the stage and the other rank."""


@dataclass(frozen=True)
class Endpoint:
    """One rank's endpoint of an exchange.

    Attributes
    ----------
    channel : channel of the ranks
    order : rank of the channel at each position
    position : position of this rank
    dtype : pixel type
    pack : function that makes a message of pixels, given their rows, the stage and the peer
    operator : merge operator
    """

    channel: Channel
    order: Sequence[int]
    position: int
    dtype: np.dtype[Any]
    pack: Pack
    operator: Operator = "over"


def run_exchange(
    own: Mapping[int, Fragment], traffic: Sequence[StageTraffic], endpoint: Endpoint
) -> tuple[tuple[Fragment, ...], tuple[StageCounters, ...]]:
    """Run all stages of an exchange.

    Parameters
    ----------
    own : this rank's layers on the whole canvas, by depth; read-only pixels are not changed
    traffic : messages and merges of this rank, with peers as positions

    Returns
    -------
    fragments : pixels that this rank owns now
    counters : one for each stage

    Raises
    ------
    ExchangeError
        A stage failed on this rank. The other ranks do not know it, so the job has to end.
    """
    held: tuple[HeldZone, ...] = (HeldZone(0, own),)
    counters = []
    for number, stage in enumerate(traffic):
        try:
            held, counted = _Stage(stage, endpoint, number).run(held)
        except ClustervizError as error:
            raise ExchangeError(f"stage {number + 1} of {len(traffic)}: {error}") from error
        counters.append(counted)
    endpoint.channel.wait_sends()
    return tuple(fragment for zone in held for fragment in zone.fragments.values()), tuple(counters)


@dataclass
class _Stage:
    """One stage in progress on one rank."""

    traffic: StageTraffic
    endpoint: Endpoint
    tag: int
    peers: dict[int, PeerCounters] = field(default_factory=dict)
    seconds_wait: float = 0.0
    seconds_blend: float = 0.0

    def run(self, held: tuple[HeldZone, ...]) -> tuple[tuple[HeldZone, ...], StageCounters]:
        """Post the receives, send, and merge what arrives."""
        waiting = self._post()
        self._send(held)
        merges = self._merges(held)
        self._receive(waiting, merges)
        started = perf_counter()
        merged = tuple(_finished(merge, running) for merge, running in zip(self.traffic.merges, merges, strict=True))
        self.seconds_blend += perf_counter() - started
        return merged, self._counters()

    def _post(self) -> list[tuple[Any, Bytes, Message]]:
        channel, order = self.endpoint.channel, self.endpoint.order
        waiting = []
        for message in self.traffic.receives:
            buffer: Bytes = np.empty(message.pixels * 4 * self.endpoint.dtype.itemsize, np.uint8)
            waiting.append((channel.post_receive(buffer, order[message.peer], self.tag), buffer, message))
        return waiting

    def _send(self, held: Sequence[HeldZone]) -> None:
        starts = [zone.begin for zone in held]
        position = self.endpoint.position
        # Begin with the next rank in front, then cyclically: the layer right behind a rank reaches it first, in order.
        for message in sorted(self.traffic.sends, key=lambda m: (m.peer > position, -m.peer)):
            started = perf_counter()
            parts = [_zone(held, starts, part.patch)[part.depth].cut(part.patch) for part in message.parts]
            payload: NDArray[Any] = parts[0].pixels if len(parts) == 1 else np.concatenate([p.pixels for p in parts])
            data = self.endpoint.pack(payload, _rows(message), (self.tag, message.peer))
            self.endpoint.channel.isend(data, self.endpoint.order[message.peer], self.tag)
            seconds = perf_counter() - started
            counted = (1, len(payload), payload.nbytes, data.nbytes, seconds)
            self.peers[message.peer] = PeerCounters(self.endpoint.order[message.peer], *counted)

    def _merges(self, held: Sequence[HeldZone]) -> list[RangeMerge]:
        """Start the merge of each zone that this rank keeps."""
        starts = [zone.begin for zone in held]
        merges = []
        for merge in self.traffic.merges:
            own = [_zone(held, starts, part.patch)[part.depth].cut(part.patch) for part in merge.zone.parts]
            merges.append(RangeMerge(merge, own, self.endpoint.dtype, self.endpoint.operator))
        return merges

    def _receive(self, waiting: list[tuple[Any, Bytes, Message]], merges: Sequence[RangeMerge]) -> None:
        begins = [merge.zone.begin for merge in self.traffic.merges]
        first = perf_counter()
        while waiting:
            started = perf_counter()
            done = dict(self.endpoint.channel.wait_some([pending for pending, _, _ in waiting]))
            arrived = perf_counter()
            for index, size in sorted(done.items()):
                _, buffer, message = waiting[index]
                peer = self.peers.get(message.peer, PeerCounters(self.endpoint.order[message.peer]))
                self.peers[message.peer] = replace(peer, seconds_wait=arrived - first)
                for part, layer in self._open(message, buffer[:size]):
                    merges[bisect_right(begins, part.patch.begin) - 1].add(part, layer)
            waiting = [item for index, item in enumerate(waiting) if index not in done]
            if waiting:
                for running in merges:
                    running.advance()
            self.seconds_wait += arrived - started
            self.seconds_blend += perf_counter() - arrived

    def _open(self, message: Message, data: Bytes) -> list[tuple[Part, Layer]]:
        """Return the layers of a message that arrived."""
        count, dtype, rows = message.pixels, self.endpoint.dtype, _rows(message)
        try:
            if len(message.parts) == 1:
                return [(message.parts[0], Layer(message.parts[0].patch, *open_message(data, count, dtype, rows)))]
            pixels = unpack(data, count, dtype, rows)
        except ClustervizError as error:
            raise ExchangeError(f"message from rank {self.endpoint.order[message.peer]}: {error}") from error
        layers, begin = [], 0
        for part in message.parts:
            layers.append((part, Layer(part.patch, pixels[begin : begin + part.patch.count])))
            begin += part.patch.count
        return layers

    def _counters(self) -> StageCounters:
        peers = tuple(self.peers.values())
        return StageCounters(
            messages_sent=sum(peer.messages_sent for peer in peers),
            pixels_sent=sum(peer.pixels_sent for peer in peers),
            bytes_raw=sum(peer.bytes_raw for peer in peers),
            bytes_sent=sum(peer.bytes_sent for peer in peers),
            seconds_encode=sum(peer.seconds_encode for peer in peers),
            seconds_wait=self.seconds_wait,
            seconds_blend=self.seconds_blend,
            peers=peers,
        )


def _finished(merge: Merge, running: RangeMerge) -> HeldZone:
    """Return the zone after its merge: one layer, or none."""
    merged = merge.merged
    return HeldZone(merged.begin, {part.depth: running.finish() for part in merged.parts})


def _zone(held: Sequence[HeldZone], starts: Sequence[int], patch: Patch) -> Mapping[int, Fragment]:
    """Return the fragments of the zone that a patch lies in."""
    return held[bisect_right(starts, patch.begin) - 1].fragments


def _rows(message: Message) -> Rows:
    """Return the row layout of a message's pixels: those of its patch, or one row for several parts."""
    patch = message.parts[0].patch
    width = patch.rect.width if len(message.parts) == 1 else message.pixels
    return Rows(patch.first % max(width, 1) if len(message.parts) == 1 else 0, width)
