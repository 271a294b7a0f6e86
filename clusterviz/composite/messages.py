"""The transport that works everywhere: a schedule's transfers as messages of a channel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.comm.channel import Channel
from clusterviz.composite.algorithms import make_schedule
from clusterviz.composite.counters import StageCounters
from clusterviz.composite.exchange import Link, Pack, run_exchange
from clusterviz.composite.footprints import Footprints
from clusterviz.composite.fragment import Fragment
from clusterviz.composite.piece import Piece
from clusterviz.composite.traffic import Part, StageTraffic, plan_traffic
from clusterviz.image.partial import PartialImage

Plan = tuple[StageTraffic, ...]


def plan_messages(footprints: Footprints, position: int, algorithm: str) -> Plan:
    """What the rank at a position sends and receives, stage by stage."""
    order = footprints.order
    patches = [footprints.patch(layer) for layer in footprints.layers]
    owners = [order.index(layer.rank) for layer in footprints.layers]
    layers: list[list[Part]] = [[] for _ in order]
    for depth, (owner, patch) in enumerate(zip(owners, patches, strict=True)):
        layers[owner].append(Part(depth, patch))
    schedule = make_schedule(algorithm, len(order), footprints.canvas.pixels, patches, owners)
    return plan_traffic(schedule, position, layers, footprints.canvas.width)


def run_messages(
    images: Sequence[PartialImage], footprints: Footprints, plan: Plan, channel: Channel, pack: Pack
) -> tuple[Piece, tuple[StageCounters, ...]]:
    """Run the plan; on ranks without pixels, nothing."""
    fragments: tuple[Fragment, ...] = ()
    stages: tuple[StageCounters, ...] = ()
    if channel.rank in footprints.order:
        link = Link(channel, footprints.order, footprints.order.index(channel.rank), footprints.dtype, pack)
        own = {
            depth: Fragment(footprints.patch(layer), _pixels(images[layer.image]))
            for depth, layer in enumerate(footprints.layers)
            if layer.rank == channel.rank
        }
        fragments, stages = run_exchange(own, plan, link)
    return Piece(footprints.canvas, footprints.dtype, fragments, footprints.order), stages


def _pixels(image: PartialImage) -> np.ndarray:
    """The pixels (n, 4), contiguous and read-only: they are the caller's."""
    pixels = np.require(image.rgba, requirements=["C", "A"]).reshape(-1, 4).view()
    pixels.setflags(write=False)
    return pixels
