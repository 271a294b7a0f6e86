"""Shared-memory transport within a node: every rank blends a strip of the picture from all images in place.

Each image is written once, into memory that the ranks of the node share. All ranks, those without pixels too, then
blend a strip each, straight into the picture in the root's part. Two exchanges of small numbers synchronize them: one
when the images are written, which also tells their offsets, and one when the strips are blended.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from clusterviz.codec.contract import Pixels
from clusterviz.comm.channel import Channel
from clusterviz.composite.counters import StageCounters
from clusterviz.composite.footprints import Footprints, gather_footprints
from clusterviz.composite.fragment import OwnedPixels, Patch
from clusterviz.composite.node_memory import NOT_PLACED, NodeMemory
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage, Rect


def share_images(
    images: Sequence[PartialImage],
    order: Sequence[int],
    channel: Channel,
    memory: NodeMemory,
    operator: Operator = "over",
) -> Footprints:
    """Copy all images of the node into shared memory, and gather their footprints and offsets; collective.

    Errors as of `gather_footprints`.
    """
    while True:
        offsets = memory.put(images)
        footprints = gather_footprints(images, order, channel, memory.exchange, offsets, operator)
        if all(layer.offset != NOT_PLACED for layer in footprints.layers):
            return footprints
        memory.grow(images)


@dataclass(frozen=True, eq=False)
class StripPlan:
    """Plan of one rank's strip; valid while the footprints and the shared memory are the same."""

    layers: tuple[Layer, ...]  # rows of the images in this rank's strip, front to back, in place
    strip: Patch  # patch of the strip, with the whole picture as canvas
    target: Pixels  # pixels of the strip (strip.count, 4), a part of the picture
    picture: Pixels | None  # the whole picture on the root; None elsewhere


def plan_strip(
    footprints: Footprints, channel: Channel, memory: NodeMemory, size: tuple[int, int], root: int
) -> StripPlan:
    """Cut the picture into strips, and find the layers of this rank's.

    `size`: (width, height) of the picture, which contains all images.
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


def blend_strip(plan: StripPlan, footprints: Footprints, memory: NodeMemory) -> tuple[OwnedPixels, StageCounters]:
    """Blend this rank's strip into the picture, and wait for the others; collective."""
    started = perf_counter()
    blend_layers(plan.layers, plan.strip, plan.target, operator=footprints.operator)
    blended = perf_counter()
    memory.exchange(np.zeros(1, np.int64))
    counters = StageCounters(seconds_blend=blended - started, seconds_wait=perf_counter() - blended)
    return OwnedPixels(footprints.canvas, footprints.dtype, (), (), picture=plan.picture, gathered=True), counters


def cut_strips(canvas: Rect, rects: Iterable[Rect], strips: int) -> list[int]:
    """Return the rows between strips of equal blending cost: strips + 1 numbers, ascending from 0 to the height.

    A row costs one unit for each pixel that is written, and one for each pixel of an image that is read. All integers,
    so that every rank computes the same cut.
    """
    steps = np.zeros(canvas.height + 1, np.int64)
    for rect in rects:
        if rect.pixels:
            steps[rect.y_begin - canvas.y_begin] += rect.width
            steps[rect.y_end - canvas.y_begin] -= rect.width
    cost = np.cumsum(canvas.width + np.cumsum(steps[:-1]))
    if not cost.size:
        return [0] * (strips + 1)
    goals = int(cost[-1]) * np.arange(1, strips, dtype=np.int64) // strips
    return [0, *(np.searchsorted(cost, goals, "left") + 1).clip(0, canvas.height).tolist(), canvas.height]
