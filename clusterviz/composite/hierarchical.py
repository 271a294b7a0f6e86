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
from clusterviz.composite.footprints import Footprint, Footprints
from clusterviz.composite.fragment import Fragment, OwnedPixels, Patch
from clusterviz.composite.gather import Pack
from clusterviz.composite.messages import plan_messages, run_messages
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.composite.shared import NOT_PLACED, NodeMemory, cut_strips
from clusterviz.image.partial import EMPTY, PartialImage, Rect

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

    `footprints`: those of all ranks, with the offsets of this node's images, from `place_images`.
    """
    groups = group_by_node(footprints, nodes)
    involved = list(dict.fromkeys(group.node for group in groups))
    strips = min((len(nodes[node]) for node in involved), default=0)
    owners = tuple(nodes[node][index] for index in range(strips) for node in involved)
    owned = OwnedPixels(footprints.canvas, footprints.dtype, (), owners)
    if channel.rank not in owners:
        return owned, ()
    started = perf_counter()
    rows = cut_strips(footprints.canvas, [image.rect for image in footprints.layers], strips)
    top, bottom = rows[memory.window.index : memory.window.index + 2]
    own, strip = _blend(footprints, top, bottom, groups, nodes, channel.rank, memory)
    blended = StageCounters(seconds_blend=perf_counter() - started)
    plan = plan_messages(strip, channel.rank, algorithm, whole=False)
    made, stages = run_messages(own, strip, plan, channel, pack)
    fragments = tuple(_moved_down(fragment, top) for fragment in made.fragments)
    return replace(owned, fragments=fragments), (blended, *stages)


def _blend(
    footprints: Footprints, top: int, bottom: int, groups: Sequence[Group], nodes: Nodes, rank: int, memory: NodeMemory
) -> tuple[dict[int, Fragment], Footprints]:
    """Blend rows [top, bottom) of this node's groups; return them by depth, and the footprints of all nodes' strips.

    The strip is a canvas of its own. In place of a node is its rank with the index of this one.
    """
    whole, dtype = footprints.canvas, footprints.dtype
    canvas = Rect(whole.x_begin, whole.y_begin + top, whole.x_end, whole.y_begin + bottom)
    strip = Footprints(canvas, dtype, (), (), footprints.operator)
    layers: list[Footprint] = []
    own = {}
    for depth, group in enumerate(groups):
        rect = EMPTY
        for image in group.images:
            if (part := image.rect.intersect(canvas)).pixels:
                rect = rect.unite(part)
        layers.append(Footprint(nodes[group.node][memory.window.index], 0, rect, 0))
        if layers[-1].rank == rank and rect.pixels:
            pixels: Any = np.empty((rect.pixels, 4), dtype)
            in_place = (memory.rows(image, canvas.y_begin, canvas.y_end, dtype) for image in group.images)
            parts = [Layer(strip.patch(part), found) for part, found in in_place if part.pixels]
            blend_layers(parts, strip.patch(rect), pixels, operator=footprints.operator)
            own[depth] = Fragment(strip.patch(rect), pixels)
    order = tuple(dict.fromkeys(layer.rank for layer in layers))
    return own, replace(strip, layers=tuple(layers), order=order)


def _moved_down(fragment: Fragment, rows: int) -> Fragment:
    """Return a fragment of a strip in the pixel numbers of the whole canvas."""
    patch, rect = fragment.patch, fragment.patch.rect
    moved = Rect(rect.x_begin, rect.y_begin + rows, rect.x_end, rect.y_end + rows)
    first = rows * patch.width
    return Fragment(Patch(patch.width, patch.begin + first, patch.end + first, moved), fragment.pixels)
