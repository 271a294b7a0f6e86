"""Footprints first: one exchange of small numbers tells every rank where all images lie, so that all plan alike.

Whatever is wrong with any partial image is found here, before a pixel moves, and raised on every rank.
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
from clusterviz.composite.over.blend import DTYPES
from clusterviz.composite.patch import Patch
from clusterviz.errors import InputError
from clusterviz.image.merge import ORDER_FREE, Operator
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import EMPTY, Rect

Numbers = NDArray[np.int64]
# What tells one row of numbers of every rank to every rank.
Share = Callable[[Numbers], Numbers]

# A row: fault, type, images, order; then two images of five numbers: rectangle and place. More images take more rows.
_HEAD, _IMAGE, _IMAGES_A_ROW = 4, 5, 2
_UNKNOWN_TYPE = -1


@dataclass(frozen=True)
class Footprint:
    """One partial image that is not empty, as every rank knows it.

    Attributes
    ----------
    rank : the channel's rank that drew it
    image : which of that rank's images
    rect : on the screen
    place : a number that the rank told with it: where its pixels lie in shared memory
    """

    rank: int
    image: int
    rect: Rect
    place: int


@dataclass(frozen=True)
class Footprints:
    """Where all images lie.

    Attributes
    ----------
    canvas : the rectangle of the screen whose pixels are numbered: the smallest that holds all images
    dtype : of every image that is not empty
    layers : the images that are not empty, front to back
    order : channel ranks that have such images, by their first, front to back; a rank's index is its *position*
    operator : how pixels of two images become one
    """

    canvas: Rect
    dtype: np.dtype[Any]
    layers: tuple[Footprint, ...]
    order: tuple[int, ...]
    operator: Operator = "over"

    @property
    def several(self) -> bool:
        """Whether images of other ranks lie between those of a rank."""
        return len(self.order) < sum(1 for _ in groupby(self.layers, key=lambda layer: layer.rank))

    def in_best_order(self, nodes: Sequence[Sequence[int]]) -> Footprints:
        """The same, with the images of each rank side by side where that changes no pixel.

        Then any algorithm takes several images a rank. Images that do not overlap may change places. Where the operator
        needs no order, those of a node are side by side, too, and each node has one layer for the others.
        """
        if len(self.layers) < 3 or (self.operator not in ORDER_FREE and not self.several):
            return self
        if self.operator in ORDER_FREE:
            place = {rank: number for number, rank in enumerate(rank for ranks in nodes for rank in ranks)}
        else:
            place = {rank: number for number, rank in enumerate(self._ranks_in_order())}
            if len(place) < len(self.order):
                return self
        layers = tuple(sorted(self.layers, key=lambda layer: place[layer.rank]))
        return replace(self, layers=layers, order=_order(layers))

    def _ranks_in_order(self) -> list[int]:
        """Ranks from front to back, each as a whole; fewer than there are where some lie in front of each other."""
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

    def patch(self, layer: Footprint) -> Patch:
        """An image as a patch of the whole canvas."""
        x, y, rect = self.canvas.x_begin, self.canvas.y_begin, layer.rect
        shifted = Rect(rect.x_begin - x, rect.y_begin - y, rect.x_end - x, rect.y_end - y)
        return Patch(self.canvas.width, 0, self.canvas.pixels, shifted)


def gather_footprints(
    images: Sequence[PartialImage],
    order: Sequence[int],
    channel: Channel,
    share: Share | None = None,
    places: Sequence[int] = (),
    operator: Operator = "over",
) -> Footprints:
    """Tell each other the footprints, leave out empty ones, and agree on what is wrong; collective.

    Parameters
    ----------
    images : of this rank, front to back
    order : channel ranks from front to back, one entry for each image of each rank
    share : tells the numbers, instead of the channel
    places : a number for each image that the others shall know
    operator : how pixels of two images become one, the same on every rank

    Raises
    ------
    InputError
        On every rank: an image with a wrong type or shape, or of a type that the operator does not merge; images of
        different types, orders that do not name every image of every rank once or that differ between ranks.
    """
    share = share or channel.allgather_numbers
    fault = _fault(images, order, channel)
    head, rows = _rows(images, order, bool(fault), places)
    first = share(np.concatenate([head, rows[0]]))
    if np.any(first[:, 0]) or np.any(first[:, 3] != first[0, 3]) or sum(map(int, first[:, 2])) != len(order):
        _raise(fault, tuple(order), len(images), channel)
    most = -(-int(first[:, 2].max()) // _IMAGES_A_ROW)
    more = [share(rows[k] if k < len(rows) else np.zeros_like(rows[0])) for k in range(1, most)]
    table = np.concatenate([first[:, _HEAD:], *more], axis=1)
    layers = _layers(order, table.reshape(len(first), -1, _IMAGE).tolist())
    return Footprints(_canvas(layers), _dtype(layers, first[:, 1], operator), layers, _order(layers), operator)


def _rows(
    images: Sequence[PartialImage], order: Sequence[int], fault: bool, places: Sequence[int]
) -> tuple[Numbers, list[Numbers]]:
    """This rank's numbers: the head, and its images row by row; where there is a fault, no images."""
    count = 0 if fault else len(images)
    dtype = DTYPES.index(images[0].rgba.dtype) if count else _UNKNOWN_TYPE
    named = zlib.crc32(np.asarray(order, np.int64).tobytes()) if not fault else 0
    rows = [np.zeros(_IMAGE * _IMAGES_A_ROW, np.int64) for _ in range(max(1, -(-count // _IMAGES_A_ROW)))]
    for index in range(count):
        rect, place = images[index].rect, places[index] if places else 0
        row, begin = rows[index // _IMAGES_A_ROW], index % _IMAGES_A_ROW * _IMAGE
        row[begin : begin + _IMAGE] = rect.x_begin, rect.y_begin, rect.x_end, rect.y_end, place
    return np.array([fault, dtype, count, named], np.int64), rows


def _layers(order: Sequence[int], table: list[list[list[int]]]) -> tuple[Footprint, ...]:
    """All images that are not empty; each entry of the order is the next image of its rank."""
    taken = [0] * len(table)
    layers = []
    for rank in order:
        image, taken[rank] = taken[rank], taken[rank] + 1
        *sides, place = table[rank][image]
        rect = Rect(*sides)
        if rect.pixels:
            layers.append(Footprint(rank, image, rect, place))
    return tuple(layers)


def _order(layers: Sequence[Footprint]) -> tuple[int, ...]:
    return tuple(dict.fromkeys(layer.rank for layer in layers))


def _canvas(layers: Sequence[Footprint]) -> Rect:
    canvas = EMPTY
    for layer in layers:
        canvas = canvas.unite(layer.rect)
    return canvas


def _dtype(layers: Sequence[Footprint], types: Numbers, operator: Operator) -> np.dtype[Any]:
    """The type of all images that are not empty; of the first there is where all are."""
    found = {int(types[layer.rank]) for layer in layers} or {int(kind) for kind in types if kind >= 0} or {0}
    if len(found) > 1 and layers:
        names = ", ".join(sorted(DTYPES[kind].name for kind in found))
        raise mark_agreed(InputError("partial images differ in pixel type", found=names))
    dtype = DTYPES[min(found)]
    if operator != "over" and layers and dtype != np.float32:
        text = f"partial images of a pixel type that the operator {operator} cannot merge"
        raise mark_agreed(InputError(text, found=dtype, allowed="float32"))
    return dtype


def _raise(fault: str, order: tuple[int, ...], count: int, channel: Channel) -> None:
    """Tell each other in words what is wrong, and raise the same everywhere."""
    reports = channel.allgather((fault, order, count))
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


def _fault(images: Sequence[PartialImage], order: Sequence[int], channel: Channel) -> str:
    """What is wrong with this rank's arguments, or nothing."""
    ranks = range(channel.size)
    if any(rank not in ranks for rank in order) or sum(rank == channel.rank for rank in order) != len(images):
        if len(images) == 1:
            return f"the visibility order is no permutation of {channel.size} ranks; found {list(order)}"
        return f"the visibility order does not name each of its {len(images)} images; found {list(order)}"
    for partial in images:
        if fault := _image_fault(partial):
            return fault
    types = sorted({image.rgba.dtype.name for image in images if image.rect.pixels})
    return f"its images differ in pixel type; found {', '.join(types)}" if len(types) > 1 else ""


def _image_fault(partial: PartialImage) -> str:
    if not isinstance(partial.rgba, np.ndarray) or partial.rgba.dtype not in DTYPES:
        found = getattr(partial.rgba, "dtype", type(partial.rgba).__name__)
        allowed = ", ".join(sorted(dtype.name for dtype in DTYPES))
        return f"wrong pixel type; found {found}; allowed {allowed}"
    shape = (partial.rect.height, partial.rect.width, 4)
    if partial.rgba.shape != shape and partial.rect.pixels:
        return f"wrong shape; found {partial.rgba.shape}; allowed {shape}, as its rectangle says"
    return ""
