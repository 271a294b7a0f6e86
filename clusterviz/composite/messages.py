"""The transport that works everywhere: a schedule's transfers as messages of a channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clusterviz.comm.channel import Channel
from clusterviz.composite.counters import StageCounters
from clusterviz.composite.exchange import Link, run_exchange
from clusterviz.composite.footprints import Footprints
from clusterviz.composite.fragment import Fragment
from clusterviz.composite.gather import Pack
from clusterviz.composite.piece import Piece
from clusterviz.composite.schedules.algorithms import make_schedule
from clusterviz.composite.traffic import Part, StageTraffic, owned_ranges, plan_traffic
from clusterviz.image.partial import PartialImage


@dataclass(frozen=True)
class Plan:
    """What one rank does, and what everybody owns in the end.

    Attributes
    ----------
    stages : what it sends and receives
    owned : (channel rank, begin, end) of all ranges of the canvas, where that is known beforehand
    """

    stages: tuple[StageTraffic, ...]
    owned: tuple[tuple[int, int, int], ...] | None


def plan_messages(footprints: Footprints, rank: int, algorithm: str) -> Plan:
    """The plan of one of the channel's ranks, which may have no pixels."""
    order = footprints.order
    patches = [footprints.patch(layer) for layer in footprints.layers]
    owners = [order.index(layer.rank) for layer in footprints.layers]
    layers: list[list[Part]] = [[] for _ in order]
    for depth, (owner, patch) in enumerate(zip(owners, patches, strict=True)):
        layers[owner].append(Part(depth, patch))
    schedule = make_schedule(algorithm, len(order), footprints.canvas.pixels, patches, owners)
    ranges = owned_ranges(schedule)
    owned = None if ranges is None else tuple((order[position], begin, end) for position, begin, end in ranges)
    if rank not in order:
        return Plan((), owned)
    whole = owned is not None
    return Plan(plan_traffic(schedule, order.index(rank), layers, footprints.canvas.width, whole=whole), owned)


def run_messages(
    images: Sequence[PartialImage], footprints: Footprints, plan: Plan, channel: Channel, pack: Pack
) -> tuple[Piece, tuple[StageCounters, ...]]:
    """Run the plan; on ranks without pixels, nothing."""
    fragments: tuple[Fragment, ...] = ()
    stages: tuple[StageCounters, ...] = ()
    if channel.rank in footprints.order:
        order, dtype = footprints.order, footprints.dtype
        link = Link(channel, order, order.index(channel.rank), dtype, pack, footprints.operator)
        own = {
            depth: Fragment(footprints.patch(layer), _pixels(images[layer.image]))
            for depth, layer in enumerate(footprints.layers)
            if layer.rank == channel.rank
        }
        fragments, stages = run_exchange(own, plan.stages, link)
    return Piece(footprints.canvas, footprints.dtype, fragments, footprints.order, plan.owned), stages


def _pixels(image: PartialImage) -> np.ndarray:
    """The pixels (n, 4), contiguous and read-only: they are the caller's."""
    pixels = np.require(image.rgba, requirements=["C", "A"]).reshape(-1, 4).view()
    pixels.setflags(write=False)
    return pixels
