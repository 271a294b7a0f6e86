"""The transport inside a node: no messages; every rank blends a strip of the picture from all images in place.

Each image is written once, into memory that the ranks of the node share. All ranks, those without pixels too, then
blend a strip each, straight into the picture in the root's part. Two exchanges of small numbers keep them in step: one
when the images are there, which also tells where they lie, and one when the strips are done.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from clusterviz.codec.contract import Pixels
from clusterviz.comm.channel import Channel
from clusterviz.composite.counters import StageCounters
from clusterviz.composite.footprints import Footprints, gather_footprints
from clusterviz.composite.node_memory import NOWHERE, NodeMemory
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.composite.patch import Patch
from clusterviz.composite.piece import Piece
from clusterviz.composite.strips import cut_strips
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect


def share_images(
    images: Sequence[PartialImage],
    order: Sequence[int],
    channel: Channel,
    memory: NodeMemory,
    operator: Operator = "over",
) -> Footprints:
    """Bring all images of the node into the window, and learn where they lie; collective.

    Raises
    ------
    InputError
        As `gather_footprints`.
    """
    while True:
        places = memory.put(images)
        footprints = gather_footprints(images, order, channel, memory.exchange, places, operator)
        if all(layer.place != NOWHERE for layer in footprints.layers):
            return footprints
        memory.grow(images)


@dataclass(frozen=True, eq=False)
class StripPlan:
    """What one rank blends: good as long as the images and their memory stay where they are.

    Attributes
    ----------
    layers : the images' rows in this rank's strip, front to back, in place
    strip : on the whole picture as canvas
    target : its pixels (strip.count, 4), a part of the picture
    picture : the whole of it, on the root; None elsewhere
    """

    layers: tuple[Layer, ...]
    strip: Patch
    target: Pixels
    picture: Pixels | None


def plan_strip(
    footprints: Footprints, channel: Channel, memory: NodeMemory, size: tuple[int, int], root: int
) -> StripPlan:
    """Cut the picture into strips, and find what lies in this rank's.

    Parameters
    ----------
    size : (width, height) of the picture, which holds all images
    """
    screen = Rect(0, 0, *size)
    members = memory.window.members
    picture = memory.picture(members.index(root), size, footprints.dtype)
    rows = cut_strips(screen, [image.rect for image in footprints.layers], len(members))
    top, bottom = rows[memory.window.index], rows[memory.window.index + 1]
    strip = Patch(screen.width, top * screen.width, bottom * screen.width, Rect(0, top, screen.width, bottom))
    layers = []
    for image in footprints.layers:
        rect, pixels = memory.rows(image, top, bottom, footprints.dtype)
        if rect.pixels:
            layers.append(Layer(Patch(screen.width, 0, screen.pixels, rect), pixels))
    mine = picture if channel.rank == root else None
    return StripPlan(tuple(layers), strip, picture[top:bottom].reshape(-1, 4), mine)


def blend_strip(plan: StripPlan, footprints: Footprints, memory: NodeMemory) -> tuple[Piece, StageCounters]:
    """Blend this rank's strip into the picture, and wait for the others; collective."""
    started = perf_counter()
    blend_layers(plan.layers, plan.strip, plan.target, operator=footprints.operator)
    blended = perf_counter()
    memory.exchange(np.zeros(1, np.int64))
    counters = StageCounters(seconds_blend=blended - started, seconds_wait=perf_counter() - blended)
    return Piece(footprints.canvas, footprints.dtype, (), (), picture=plan.picture, gathered=True), counters
