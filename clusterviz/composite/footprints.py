"""Footprints of all partial images, exchanged before compositing so that all ranks make the same plan.

Errors in any partial image are found here, before a pixel moves, and raised on every rank.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.agree import mark_agreed
from clusterviz.comm.channel import Channel
from clusterviz.composite.fragment import Patch
from clusterviz.composite.over.blend import DTYPES
from clusterviz.errors import InputError
from clusterviz.image.merge import ORDER_FREE, Operator
from clusterviz.image.partial import PartialImage, Rect, bounding_rect

Numbers = NDArray[np.int64]
# Gathers one row of numbers from each rank on every rank.
Exchange = Callable[[Numbers], Numbers]

# A row: error, type, images, order; then two images of five numbers: rectangle and offset. More images need more rows.
_HEAD, _IMAGE, _IMAGES_A_ROW = 4, 5, 2
_UNKNOWN_TYPE = -1


@dataclass(frozen=True)
class Footprint:
    """Footprint of one partial image that is not empty."""

    rank: int  # rank of the channel that drew it
    image: int  # index among the images of that rank
    rect: Rect  # rectangle on the screen
    offset: int  # offset of its pixels in shared memory, where that is used


@dataclass(frozen=True)
class Footprints:
    canvas: Rect  # smallest rectangle of the screen that contains all images; its pixels are numbered
    dtype: np.dtype[Any]  # pixel type of every image that is not empty
    layers: tuple[Footprint, ...]  # images that are not empty, front to back
    # channel ranks with such images, by their first, front to back; a rank's index is its *position*
    order: tuple[int, ...]
    operator: Operator = "over"  # merge operator

    @property
    def interleaved(self) -> bool:
        """Whether an image of another rank lies between two of one rank."""
        return len(self.order) < sum(1 for _ in groupby(self.layers, key=lambda layer: layer.rank))

    def in_best_order(self, nodes: Sequence[Sequence[int]]) -> Footprints:
        """Return the footprints with the images of each rank adjacent, where that changes no pixel.

        Any algorithm can then handle several images per rank. Images that do not overlap may be swapped. If the
        operator needs no order, those of a node are adjacent too, and each node has one layer for the others.
        """
        if len(self.layers) < 3 or (self.operator not in ORDER_FREE and not self.interleaved):
            return self
        if self.operator in ORDER_FREE:
            position = {rank: number for number, rank in enumerate(rank for ranks in nodes for rank in ranks)}
        else:
            position = {rank: number for number, rank in enumerate(self._ranks_in_order())}
            if len(position) < len(self.order):
                return self
        layers = tuple(sorted(self.layers, key=lambda layer: position[layer.rank]))
        return replace(self, layers=layers, order=_order(layers))

    def _ranks_in_order(self) -> list[int]:
        """Return whole ranks from front to back; some are missing where ranks lie in front of each other."""
        sides = np.array([(r.x_begin, r.y_begin, r.x_end, r.y_end) for r in (each.rect for each in self.layers)])
        ranks = np.array([self.order.index(each.rank) for each in self.layers])
        begin, end = sides[:, None, :2], sides[:, None, 2:]
        meet = ((begin < end.swapaxes(0, 1)) & (begin.swapaxes(0, 1) < end)).all(axis=2)
        front, behind = np.nonzero(np.triu(meet & (ranks[:, None] != ranks), 1))
        in_front = np.zeros((len(self.order), len(self.order)), bool)
        in_front[ranks[front], ranks[behind]] = True
        left, found = list(range(len(self.order))), list[int]()
        while free := [rank for rank in left if not in_front[left, rank].any()]:
            found.append(self.order[free[0]])
            left.remove(free[0])
        return found

    def patch(self, rect: Rect) -> Patch:
        """Return a rectangle of the screen as a patch of the whole canvas."""
        x, y = (self.canvas.x_begin, self.canvas.y_begin) if rect.pixels else (rect.x_begin, rect.y_begin)
        shifted = Rect(rect.x_begin - x, rect.y_begin - y, rect.x_end - x, rect.y_end - y)
        return Patch(self.canvas.width, 0, self.canvas.pixels, shifted)


def gather_footprints(
    images: Sequence[PartialImage],
    order: Sequence[int],
    channel: Channel,
    exchange: Exchange | None = None,
    offsets: Sequence[int] = (),
    operator: Operator = "over",
) -> Footprints:
    """Exchange the footprints of all ranks, leave out empty ones, and agree on errors; collective.

    Raises InputError on every rank for an image with a wrong type or shape, or of a type that the operator does not
    merge; images of different types, orders that do not name every image of every rank once or that differ between
    ranks.

    `images`: this rank's images, front to back; `order`: channel ranks from front to back, one entry for each image of
    each rank; `exchange`: gathers the numbers, instead of the channel; `offsets`: offset in shared memory of each
    image; `operator`: merge operator, the same on every rank.
    """
    exchange = exchange or channel.allgather_numbers
    error = _argument_error(images, order, channel)
    head, rows = _rows(images, order, bool(error), offsets)
    first = exchange(np.concatenate([head, rows[0]]))
    if np.any(first[:, 0]) or np.any(first[:, 3] != first[0, 3]) or sum(map(int, first[:, 2])) != len(order):
        _raise_agreed(error, tuple(order), len(images), channel)
    most = -(-int(first[:, 2].max()) // _IMAGES_A_ROW)
    more = [exchange(rows[k] if k < len(rows) else np.zeros_like(rows[0])) for k in range(1, most)]
    table = np.concatenate([first[:, _HEAD:], *more], axis=1)
    layers = _layers(order, table.reshape(len(first), -1, _IMAGE).tolist())
    canvas = bounding_rect(layer.rect for layer in layers)
    return Footprints(canvas, _dtype(layers, first[:, 1], operator), layers, _order(layers), operator)


def _rows(
    images: Sequence[PartialImage], order: Sequence[int], error: bool, offsets: Sequence[int]
) -> tuple[Numbers, list[Numbers]]:
    """Return this rank's numbers: the head, and rows of images; no images if there is an error."""
    count = 0 if error else len(images)
    dtype = DTYPES.index(images[0].rgba.dtype) if count else _UNKNOWN_TYPE
    named = zlib.crc32(np.asarray(order, np.int64).tobytes()) if not error else 0
    rows = [np.zeros(_IMAGE * _IMAGES_A_ROW, np.int64) for _ in range(max(1, -(-count // _IMAGES_A_ROW)))]
    for index in range(count):
        rect, offset = images[index].rect, offsets[index] if offsets else 0
        row, begin = rows[index // _IMAGES_A_ROW], index % _IMAGES_A_ROW * _IMAGE
        row[begin : begin + _IMAGE] = rect.x_begin, rect.y_begin, rect.x_end, rect.y_end, offset
    return np.array([error, dtype, count, named], np.int64), rows


def _layers(order: Sequence[int], table: list[list[list[int]]]) -> tuple[Footprint, ...]:
    """Return the images that are not empty; each entry of the order is the next image of its rank."""
    taken = [0] * len(table)
    layers = []
    for rank in order:
        image, taken[rank] = taken[rank], taken[rank] + 1
        *sides, offset = table[rank][image]
        rect = Rect(*sides)
        if rect.pixels:
            layers.append(Footprint(rank, image, rect, offset))
    return tuple(layers)


def _order(layers: Sequence[Footprint]) -> tuple[int, ...]:
    return tuple(dict.fromkeys(layer.rank for layer in layers))


def _dtype(layers: Sequence[Footprint], types: Numbers, operator: Operator) -> np.dtype[Any]:
    """Return the type of the images that are not empty, or of any image if all are empty."""
    found = {int(types[layer.rank]) for layer in layers} or {int(kind) for kind in types if kind >= 0} or {0}
    if len(found) > 1 and layers:
        names = ", ".join(sorted(DTYPES[kind].name for kind in found))
        raise mark_agreed(InputError("partial images differ in pixel type", found=names))
    dtype = DTYPES[min(found)]
    if operator != "over" and layers and dtype != np.float32:
        text = f"partial images of a pixel type that the operator {operator} cannot merge"
        raise mark_agreed(InputError(text, found=dtype, allowed="float32"))
    return dtype


def _raise_agreed(error: str, order: tuple[int, ...], count: int, channel: Channel) -> None:
    reports = channel.allgather((error, order, count))
    for rank, (text, other, _) in enumerate(reports):
        if text:
            raise mark_agreed(InputError(text, where=f"partial image of rank {rank}"))
        if other != reports[0][1]:
            raise mark_agreed(InputError(f"ranks 0 and {rank} give different visibility orders"))
    named = [order.count(rank) for rank in range(len(reports))]
    given = [count for _, _, count in reports]
    raise mark_agreed(
        InputError("the visibility order names images that are not there, or not all", found=named, allowed=given)
    )


def _argument_error(images: Sequence[PartialImage], order: Sequence[int], channel: Channel) -> str:
    """Return what is wrong with this rank's arguments, or an empty text."""
    ranks = range(channel.size)
    if any(rank not in ranks for rank in order) or sum(rank == channel.rank for rank in order) != len(images):
        if len(images) == 1:
            return f"the visibility order is no permutation of {channel.size} ranks; found {list(order)}"
        return f"the visibility order does not name each of its {len(images)} images; found {list(order)}"
    for partial in images:
        if error := _image_error(partial):
            return error
    types = sorted({image.rgba.dtype.name for image in images if image.rect.pixels})
    return f"its images differ in pixel type; found {', '.join(types)}" if len(types) > 1 else ""


def _image_error(partial: PartialImage) -> str:
    if not isinstance(partial.rgba, np.ndarray) or partial.rgba.dtype not in DTYPES:
        found = getattr(partial.rgba, "dtype", type(partial.rgba).__name__)
        allowed = ", ".join(sorted(dtype.name for dtype in DTYPES))
        return f"wrong pixel type; found {found}; allowed {allowed}"
    shape = (partial.rect.height, partial.rect.width, 4)
    if partial.rgba.shape != shape and partial.rect.pixels:
        return f"wrong shape; found {partial.rgba.shape}; allowed {shape}, as its rectangle says"
    return ""
