"""Message transport: a schedule's transfers as messages of a channel, packed by a codec."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from clusterviz.codec import AutoCodec, Rows, pack, prepare_codecs
from clusterviz.codec.contract import Bytes, Pixels
from clusterviz.comm.channel import Channel
from clusterviz.composite.counters import StageCounters
from clusterviz.composite.exchange import Endpoint, run_exchange
from clusterviz.composite.footprints import Footprints
from clusterviz.composite.fragment import Fragment, OwnedPixels
from clusterviz.composite.gather import Pack
from clusterviz.composite.model.network import Network
from clusterviz.composite.schedules.algorithms import make_schedule
from clusterviz.composite.traffic import Part, StageTraffic, owned_ranges, plan_traffic
from clusterviz.image.partial import PartialImage


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
