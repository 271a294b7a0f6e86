"""Hierarchical transport: shared memory inside a node, messages of any algorithm among nodes.

The picture is cut into as many strips as the smallest node has ranks. On every node, rank i blends strip i of the
node's images in place. Then the ranks i of all nodes composite strip i among themselves. Every node sends and receives
through several ranks at once, and a pixel crosses the network as if there were one image per node.

Images of one node that are neighbours in visibility order become one layer; if the operator needs no order, all of
them do. If another node's image lies between them there are more layers than nodes, and the algorithm must support
several images per rank. Bytes are rounded once on the node, and then as the algorithm does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.comm.channel import Channel
from clusterviz.comm.window import MAX_NUMBERS
from clusterviz.composite.counters import StageCounters
from clusterviz.composite.exchange import Endpoint, run_exchange
from clusterviz.composite.footprints import Footprint, Footprints
from clusterviz.composite.fragment import Fragment, OwnedPixels, Patch, unite
from clusterviz.composite.gather import Pack
from clusterviz.composite.node_memory import NOT_PLACED, NodeMemory
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.composite.schedules.algorithms import make_schedule
from clusterviz.composite.schedules.schedule import Schedule
from clusterviz.composite.shared import cut_strips
from clusterviz.composite.traffic import Part, plan_traffic
from clusterviz.image.partial import PartialImage, Rect

Nodes = Sequence[Sequence[int]]


@dataclass(frozen=True)
class Group:
    """Images of one node that are neighbours in visibility order."""

    node: int
    images: tuple[Footprint, ...]


def group_by_node(footprints: Footprints, nodes: Nodes) -> list[Group]:
    """Return the groups of all images, front to back."""
    node_of = {rank: number for number, ranks in enumerate(nodes) for rank in ranks}
    groups: list[Group] = []
    for image in footprints.layers:
        node = node_of[image.rank]
        if groups and groups[-1].node == node:
            groups[-1] = Group(node, (*groups[-1].images, image))
        else:
            groups.append(Group(node, (image,)))
    return groups


def place_images(
    images: Sequence[PartialImage], footprints: Footprints, channel: Channel, memory: NodeMemory
) -> Footprints:
    """Copy images into the memory of their nodes, and return the footprints with offsets on this node; collective."""
    while True:
        offsets = memory.put(images)
        if not channel.maximum(NOT_PLACED in offsets):
            break
        memory.grow(images)
    members = memory.window.members
    most = max((image.image + 1 for image in footprints.layers if image.rank in members), default=1)
    rows = np.zeros(-(-most // MAX_NUMBERS) * MAX_NUMBERS, np.int64)
    rows[: len(offsets)] = offsets
    gathered = np.concatenate([memory.exchange(part) for part in rows.reshape(-1, MAX_NUMBERS)], axis=1)
    here = {rank: gathered[index].tolist() for index, rank in enumerate(members)}
    layers = (
        replace(image, offset=here[image.rank][image.image]) if image.rank in here else image
        for image in footprints.layers
    )
    return replace(footprints, layers=tuple(layers))


def compose_strip(
    footprints: Footprints, nodes: Nodes, channel: Channel, memory: NodeMemory, algorithm: str, pack: Pack
) -> tuple[OwnedPixels, tuple[StageCounters, ...]]:
    """Blend this rank's strip of its node's images, and composite it with the other nodes; collective.

    Parameters
    ----------
    footprints : those of all ranks, with the offsets of this node's images, from `place_images`
    nodes : ranks of each node
    """
    groups = group_by_node(footprints, nodes)
    involved = list(dict.fromkeys(group.node for group in groups))
    strips = min((len(nodes[node]) for node in involved), default=0)
    owners = tuple(nodes[node][index] for index in range(strips) for node in involved)
    owned = OwnedPixels(footprints.canvas, footprints.dtype, (), owners)
    if channel.rank not in owners:
        return owned, ()
    index = memory.window.index
    rows = cut_strips(footprints.canvas, [image.rect for image in footprints.layers], strips)
    strip = _Strip(footprints, rows[index], rows[index + 1])
    order = tuple(nodes[node][index] for node in involved)
    started = perf_counter()
    own = strip.blend([group for group in groups if channel.rank in nodes[group.node]], groups, memory)
    blended = StageCounters(seconds_blend=perf_counter() - started)
    position = order.index(channel.rank)
    schedule = strip.schedule(groups, involved, algorithm)
    plan = plan_traffic(schedule, position, strip.layers(groups, involved), strip.canvas.width)
    endpoint = Endpoint(channel, order, position, footprints.dtype, pack, footprints.operator)
    fragments, stages = run_exchange(own, plan, endpoint)
    return replace(owned, fragments=tuple(map(strip.on_canvas, fragments))), (blended, *stages)


class _Strip:
    """Rows [top, bottom) of the canvas, as a canvas of its own."""

    def __init__(self, footprints: Footprints, top: int, bottom: int) -> None:
        whole = footprints.canvas
        self._dtype, self._operator = footprints.dtype, footprints.operator
        self._top = top
        self.canvas = Rect(whole.x_begin, whole.y_begin + top, whole.x_end, whole.y_begin + bottom)

    def blend(self, mine: Sequence[Group], groups: Sequence[Group], memory: NodeMemory) -> dict[int, Fragment]:
        """Blend each group of this node; return the fragments by depth."""
        blended = {}
        for group in mine:
            patch = self._patch(group)
            if patch.count:
                pixels: Any = np.empty((patch.count, 4), self._dtype)
                blend_layers(self._in_place(group, memory), patch, pixels, operator=self._operator)
                blended[groups.index(group)] = Fragment(patch, pixels)
        return blended

    def schedule(self, groups: Sequence[Group], involved: Sequence[int], algorithm: str) -> Schedule:
        """Return the schedule among the nodes."""
        patches = [self._patch(group) for group in groups]
        owners = [involved.index(group.node) for group in groups]
        return make_schedule(algorithm, len(involved), self.canvas.pixels, patches, owners)

    def layers(self, groups: Sequence[Group], involved: Sequence[int]) -> list[list[Part]]:
        """Return the layers of each node, by position."""
        parts: list[list[Part]] = [[] for _ in involved]
        for depth, group in enumerate(groups):
            parts[involved.index(group.node)].append(Part(depth, self._patch(group)))
        return parts

    def on_canvas(self, fragment: Fragment) -> Fragment:
        """Return a fragment of the strip in the pixel numbers of the whole canvas."""
        patch, rect, rows = fragment.patch, fragment.patch.rect, self._top
        moved = Rect(rect.x_begin, rect.y_begin + rows, rect.x_end, rect.y_end + rows)
        first = rows * patch.width
        return Fragment(Patch(patch.width, patch.begin + first, patch.end + first, moved), fragment.pixels)

    def _in_place(self, group: Group, memory: NodeMemory) -> list[Layer]:
        rows = (memory.rows(image, self.canvas.y_begin, self.canvas.y_end, self._dtype) for image in group.images)
        return [Layer(self._moved(rect), pixels) for rect, pixels in rows if rect.pixels]

    def _patch(self, group: Group) -> Patch:
        """Return the smallest patch that contains the group's images."""
        patches = [self._moved(image.rect.intersect(self.canvas)) for image in group.images]
        return unite(self.canvas.width, 0, self.canvas.pixels, [patch for patch in patches if patch.count])

    def _moved(self, rect: Rect) -> Patch:
        x, y = (self.canvas.x_begin, self.canvas.y_begin) if rect.pixels else (rect.x_begin, rect.y_begin)
        moved = Rect(rect.x_begin - x, rect.y_begin - y, rect.x_end - x, rect.y_end - y)
        return Patch(self.canvas.width, 0, self.canvas.pixels, moved)
