"""Message transport: a schedule's transfers as messages of a channel, packed by a codec.

The exchange engine runs the traffic of any schedule over any channel. In each stage all receives are posted before any
send. Sends start in rotated order, so that no two ranks begin with the same target. Messages are merged as they arrive.
Bytes are rounded once per stage: keeping float32 between stages takes twice the time (8 ranks, dense), and does not
remove the error of the opacities that travel. The engine depends neither on the algorithm nor on the merge operator.

Over is associative but not commutative, and with rounding neither over nor sums are exactly associative. The order of
merging is therefore fixed: this rank's own layers and those behind them, front to back; the layers before them, front
to back; then the one result over the other. Intermediate results are float32 and rounded once. Layers that have
arrived without a gap are merged while other messages travel, if they are enough for a pass.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec import AutoCodec, Rows, open_message, pack, prepare_codecs, unpack
from clusterviz.codec.contract import Bytes, Pixels
from clusterviz.comm.channel import Channel
from clusterviz.composite.counters import PeerCounters, StageCounters, summed
from clusterviz.composite.footprints import Footprints
from clusterviz.composite.fragment import Fragment, OwnedPixels, Patch
from clusterviz.composite.gather import Pack
from clusterviz.composite.model.network import Network
from clusterviz.composite.over import blend
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.composite.schedules.algorithms import make_schedule
from clusterviz.composite.traffic import Merge, Message, Part, StageTraffic, owned_ranges, plan_traffic
from clusterviz.errors import ClustervizError
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage

# Fewest layers that are merged before the rest has arrived; smaller passes cost more time than they save waiting.
LAYERS_AT_ONCE = 4


class RangeMerge:
    """Merge of one range in progress; `own` are this rank's fragments, one for each part of the zone."""

    def __init__(self, merge: Merge, own: list[Fragment], dtype: np.dtype[Any], operator: Operator = "over") -> None:
        self._result = merge.result
        self._dtype, self._operator = dtype, operator
        parts = sorted((*merge.zone.parts, *merge.incoming), key=lambda part: (part.depth, part.patch.begin))
        self._before = _OrderedLayers([part for part in parts if part.depth < merge.depth])
        self._behind = _OrderedLayers([part for part in parts if part.depth >= merge.depth])
        self._missing = len(merge.incoming)
        for part, fragment in zip(merge.zone.parts, own, strict=True):
            self._behind.put(part, Layer(fragment.patch, fragment.pixels))

    def add(self, part: Part, layer: Layer) -> None:
        (self._before if part in self._before.parts else self._behind).put(part, layer)
        self._missing -= 1

    def advance(self) -> None:
        """Merge the layers that are ready, while other messages travel."""
        if self._missing:
            for ordered in (self._behind, self._before):
                ordered.merge_ready(self._result, self._operator)

    def finish(self) -> Fragment:
        """Return the merged range, after all layers have arrived."""
        before, behind = self._before.layers(), self._behind.layers()
        layers = [*before, *behind]
        if len(layers) == 1:
            only = layers[0]
            if only.runs is None and only.patch == self._result and only.pixels.dtype == self._dtype:
                return Fragment(self._result, only.pixels)
        if len(layers) == 2 and (merged := self._in_place(*layers)):
            return merged
        pixels: Any = np.empty((self._result.count, 4), self._dtype)
        blend_layers(layers, self._result, pixels, operator=self._operator, split=len(before))
        return Fragment(self._result, pixels)

    def _in_place(self, front: Layer, back: Layer) -> Fragment | None:
        types = {front.pixels.dtype, back.pixels.dtype}
        if front.runs is not None or back.runs is not None or types != {self._dtype}:
            return None
        near, far = Fragment(front.patch, front.pixels), Fragment(back.patch, back.pixels)
        return merge_in_place(near, far, self._result, self._operator)


class _OrderedLayers:
    """Layers from front to back; a slot is None until its layer has arrived."""

    def __init__(self, parts: list[Part]) -> None:
        self.parts = {part: index for index, part in enumerate(parts)}
        self._slots: list[Layer | None] = [None] * len(parts)
        self._merged = 0
        self._front: Layer | None = None

    def put(self, part: Part, layer: Layer) -> None:
        self._slots[self.parts[part]] = layer

    def merge_ready(self, patch: Patch, operator: Operator) -> None:
        """Merge the layers that have arrived without a gap, beginning in front."""
        ready = self._merged
        while ready < len(self._slots) and self._slots[ready] is not None:
            ready += 1
        if ready - self._merged >= LAYERS_AT_ONCE:
            pixels = np.empty((patch.count, 4), np.float32)
            blend_layers(self.layers(ready), patch, pixels, operator=operator)
            self._slots[self._merged : ready] = [None] * (ready - self._merged)
            self._front, self._merged = Layer(patch, pixels), ready

    def layers(self, end: int | None = None) -> list[Layer]:
        """Return the layers before slot `end`, front to back."""
        rest = [layer for layer in self._slots[self._merged : end] if layer is not None]
        return [self._front, *rest] if self._front else rest


def merge_in_place(front: Fragment, back: Fragment, result: Patch, operator: Operator) -> Fragment | None:
    """Merge two fragments in the memory of one that is writeable and has the result's patch; None if neither does."""
    if back.patch == result and back.pixels.flags.writeable:
        blend.put_before(back.pixels, back.patch, front.pixels, front.patch, operator=operator)
        return back
    if front.patch == result and front.pixels.flags.writeable:
        blend.put_behind(front.pixels, front.patch, back.pixels, back.patch, operator=operator)
        return front
    return None


@dataclass(frozen=True, eq=False)
class HeldZone:
    """Pixels of one zone: its first pixel number, and its fragments by depth of the layer."""

    begin: int
    fragments: Mapping[int, Fragment]


class ExchangeError(ClustervizError):
    """A stage of compositing failed; the text names the stage and the other rank."""


@dataclass(frozen=True)
class Endpoint:
    """One rank's endpoint of an exchange."""

    channel: Channel
    order: Sequence[int]  # rank of the channel at each position
    position: int  # position of this rank
    dtype: np.dtype[Any]
    pack: Pack  # function that makes a message of pixels, given their rows, the stage and the peer
    operator: Operator = "over"


def run_exchange(
    own: Mapping[int, Fragment], traffic: Sequence[StageTraffic], endpoint: Endpoint
) -> tuple[tuple[Fragment, ...], tuple[StageCounters, ...]]:
    """Run all stages of an exchange.

    Parameters
    ----------
    own : this rank's layers on the whole canvas, by depth; read-only pixels are not changed
    traffic : messages and merges of this rank, with peers as positions

    Returns the pixels that this rank owns now, and counters of each stage. An ExchangeError is raised on this rank
    only. The other ranks do not know it, so the job has to end.
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
        peers = tuple(self.peers.values())
        counted = summed(peers, seconds_blend=self.seconds_blend, peers=peers)
        # Waiting for several peers at once is one wait.
        return merged, replace(counted, seconds_wait=self.seconds_wait)

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
            counted = (1, len(payload), payload.nbytes, data.nbytes, perf_counter() - started)
            self.peers[message.peer] = PeerCounters(*counted, peer=self.endpoint.order[message.peer])

    def _merges(self, held: Sequence[HeldZone]) -> list[RangeMerge]:
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
                peer = self.peers.get(message.peer, PeerCounters(peer=self.endpoint.order[message.peer]))
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


def _finished(merge: Merge, running: RangeMerge) -> HeldZone:
    merged = merge.merged
    return HeldZone(merged.begin, {part.depth: running.finish() for part in merged.parts})


def _zone(held: Sequence[HeldZone], starts: Sequence[int], patch: Patch) -> Mapping[int, Fragment]:
    return held[bisect_right(starts, patch.begin) - 1].fragments


def _rows(message: Message) -> Rows:
    """Return the row layout of a message's pixels: those of its patch, or one row for several parts."""
    patch = message.parts[0].patch
    width = patch.rect.width if len(message.parts) == 1 else message.pixels
    return Rows(patch.first % max(width, 1) if len(message.parts) == 1 else 0, width)


@dataclass(frozen=True)
class MessagePlan:
    """Messages of one rank, and final owners of the pixels."""

    stages: tuple[StageTraffic, ...]  # messages sent and received
    # (channel rank, begin, end) of all ranges of the canvas; None if only the owners know them
    owned: tuple[tuple[int, int, int], ...] | None


def plan_messages(footprints: Footprints, rank: int, algorithm: str, *, whole: bool = True) -> MessagePlan:
    """Return the plan of one of the channel's ranks, which may have no pixels.

    `whole`: whether owned pixels include blank ones, so that all ranks know the owners where the schedule tells them.
    """
    order = footprints.order
    patches = [footprints.patch(layer.rect) for layer in footprints.layers]
    owners = [order.index(layer.rank) for layer in footprints.layers]
    layers: list[list[Part]] = [[] for _ in order]
    for depth, (owner, patch) in enumerate(zip(owners, patches, strict=True)):
        layers[owner].append(Part(depth, patch))
    schedule = make_schedule(algorithm, len(order), footprints.canvas.pixels, patches, owners)
    ranges = owned_ranges(schedule) if whole else None
    owned = None if ranges is None else tuple((order[position], begin, end) for position, begin, end in ranges)
    if rank not in order:
        return MessagePlan((), owned)
    whole = owned is not None
    return MessagePlan(plan_traffic(schedule, order.index(rank), layers, footprints.canvas.width, whole=whole), owned)


def run_messages(
    own: Mapping[int, Fragment], footprints: Footprints, plan: MessagePlan, channel: Channel, pack: Pack
) -> tuple[OwnedPixels, tuple[StageCounters, ...]]:
    """Run a plan, given this rank's images by depth; ranks without pixels do nothing."""
    fragments: tuple[Fragment, ...] = ()
    stages: tuple[StageCounters, ...] = ()
    order, dtype = footprints.order, footprints.dtype
    if channel.rank in order:
        endpoint = Endpoint(channel, order, order.index(channel.rank), dtype, pack, footprints.operator)
        fragments, stages = run_exchange(own, plan.stages, endpoint)
    return OwnedPixels(footprints.canvas, dtype, fragments, order, plan.owned), stages


def own_fragments(images: Sequence[PartialImage], footprints: Footprints, rank: int) -> dict[int, Fragment]:
    """Return a rank's images by depth."""
    return {
        depth: Fragment(footprints.patch(layer.rect), _pixels(images[layer.image]))
        for depth, layer in enumerate(footprints.layers)
        if layer.rank == rank
    }


def _pixels(image: PartialImage) -> np.ndarray:
    pixels = np.require(image.rgba, requirements=["C", "A"]).reshape(-1, 4).view()
    pixels.setflags(write=False)
    return pixels


def packer(codec: str, network: Network, nodes: int) -> Pack:
    """Return the function that packs messages: one codec for all, or with "auto" the fastest on the slowest link."""
    if codec == "auto":
        return AutoCodec(network.seconds_per_byte if nodes > 1 else network.node_seconds_per_byte).pack
    return lambda pixels, rows, key: pack(pixels, codec, rows)


class CountingPacker:
    """Packer that counts messages, pixels, bytes and seconds."""

    def __init__(self, pack: Pack) -> None:
        self._pack = pack
        self.messages = self.pixels = self.bytes = 0
        self.seconds = 0.0

    def __call__(self, pixels: Pixels, rows: Rows, key: tuple[int, int]) -> Bytes:
        started = perf_counter()
        message = self._pack(pixels, rows, key)
        self.seconds += perf_counter() - started
        self.messages += 1
        self.pixels += len(pixels)
        self.bytes += message.nbytes
        return message


def compile_codecs(channel: Channel) -> None:
    """Compile the kernels of codecs on one rank of each node, and load them on the others; collective."""
    if channel.placement().local_rank == 0:
        prepare_codecs()
    channel.barrier()
    prepare_codecs()
