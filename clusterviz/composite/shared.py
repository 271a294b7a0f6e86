"""Shared-memory transport within a node: every rank blends a strip of the picture from all images in place.

Each image is written once, into memory that the ranks of the node share. All ranks, those without pixels too, then
blend a strip each, straight into the picture in the root's part. Two exchanges of small numbers synchronize them: one
when the images are written, which also tells their offsets, and one when the strips are blended.

Each rank's part of the memory holds its images; the root's part begins with the picture. Parts grow with the images, on
all ranks together. Earlier memory stays mapped until the end, because a caller may still use a picture in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Pixels
from clusterviz.comm.channel import Channel
from clusterviz.comm.window import Numbers, SharedWindow
from clusterviz.composite.counters import StageCounters
from clusterviz.composite.footprints import Footprint, Footprints, gather_footprints
from clusterviz.composite.fragment import OwnedPixels, Patch
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.image.merge import Operator
from clusterviz.image.partial import PartialImage, Rect

# Images are aligned to cache lines.
_LINE_BYTES = 64
# Factor by which a part is larger than needed, so that images may grow for some frames.
_GROWTH = 1.25
NOT_PLACED = -1


class NodeMemory:
    """A shared window of a node, and the offsets of images in it.

    `picture_bytes`: bytes for the picture in this rank's part; 0 for all but the root.
    """

    def __init__(self, channel: Channel, picture_bytes: int) -> None:
        self._channel = channel
        self._picture_bytes = _whole_lines(picture_bytes)
        self._window: SharedWindow | None = None
        self._retired: list[SharedWindow] = []
        self._used = 0

    @property
    def window(self) -> SharedWindow:
        """Window of the last `put`."""
        if self._window is None:
            raise ValueError("nothing was put into the window yet")
        return self._window

    def image(self, rect: Rect, dtype: np.dtype[Any]) -> Pixels:
        """Return memory for an image of the next frame, (height, width, 4): in the window if it has space, else new."""
        shape = (rect.height, rect.width, 4)
        size = rect.pixels * 4 * dtype.itemsize
        if self._window is None or self._picture_bytes + self._used + _whole_lines(size) > self._part().size:
            return np.empty(shape, dtype)
        begin = self._picture_bytes + self._used
        self._used += _whole_lines(size)
        return self._part()[begin : begin + size].view(dtype).reshape(shape)

    def put(self, images: Sequence[PartialImage]) -> list[int]:
        """Copy images into this rank's part, unless they are there; return their offsets, NOT_PLACED for lack of space.

        Collective on the first call, which allocates the window.
        """
        if self._window is None:
            self.grow(images)
        offsets = []
        for image in images:
            offset = self._offset(image) if image.rect.pixels else self._picture_bytes
            if offset == NOT_PLACED:
                memory = self.image(image.rect, image.rgba.dtype)
                np.copyto(memory, image.rgba)
                offset = self._offset(PartialImage(image.rect, memory))
            offsets.append(offset)
        self._used = 0
        return offsets

    def grow(self, images: Sequence[PartialImage]) -> None:
        """Allocate a new window with space for these images; collective."""
        size = self._picture_bytes + sum(_whole_lines(image.rgba.nbytes) for image in images)
        window = self._channel.window(int(size * _GROWTH))
        if self._window is not None:
            self._retired.append(self._window)
        self._window, self._used = window, 0

    def rows(self, image: Footprint, top: int, bottom: int, dtype: np.dtype[Any]) -> tuple[Rect, Pixels]:
        """Return rectangle and pixels of the rows of a member's image in [top, bottom) of the screen."""
        rect = image.rect
        inside = rect.intersect(Rect(rect.x_begin, top, rect.x_end, bottom))
        part = self.window.part(self.window.members.index(image.rank))
        begin = image.offset + (inside.y_begin - rect.y_begin) * rect.width * 4 * dtype.itemsize
        data = part[begin : begin + inside.pixels * 4 * dtype.itemsize].view(dtype).reshape(-1, 4)
        data.setflags(write=False)
        return inside, data

    def picture(self, root: int, size: tuple[int, int], dtype: np.dtype[Any]) -> Pixels:
        """Return the picture (height, width, 4) in the root's part; every member may write its own rows."""
        count = size[0] * size[1] * 4 * dtype.itemsize
        return self.window.part(root)[:count].view(dtype).reshape(size[1], size[0], 4)

    def exchange(self, numbers: Numbers) -> Numbers:
        """Exchange small numbers between all members; earlier writes of all are visible afterwards."""
        return self.window.exchange(numbers)

    def free(self) -> None:
        """Free all windows; collective."""
        for window in (*self._retired, self._window):
            if window is not None:
                window.free()
        self._retired.clear()
        self._window = None

    def _part(self) -> NDArray[np.uint8]:
        return self.window.part(self.window.index)

    def _offset(self, image: PartialImage) -> int:
        """Return the offset of an image in this rank's part, or NOT_PLACED."""
        part = self._part()
        begin = image.rgba.ctypes.data - part.ctypes.data
        inside = image.rgba.flags.c_contiguous and self._picture_bytes <= begin <= part.size - image.rgba.nbytes
        return begin if inside else NOT_PLACED


def _whole_lines(size: int) -> int:
    return -(-size // _LINE_BYTES) * _LINE_BYTES


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
