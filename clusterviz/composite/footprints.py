"""Footprints first: one allgather tells every rank where all images lie, so that all compute one schedule.

Whatever is wrong with any partial image is found here, before a pixel moves, and raised on every rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clusterviz.comm.agree import mark_agreed
from clusterviz.comm.channel import Channel
from clusterviz.composite.blend import DTYPES
from clusterviz.composite.patch import Patch
from clusterviz.errors import InputError
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import EMPTY, Rect


@dataclass(frozen=True)
class Footprints:
    """Where all images lie.

    Attributes
    ----------
    canvas : the smallest rectangle of the screen that holds them all
    dtype : of every image that is not empty
    order : channel ranks of the images that are not empty, front to back
    patches : what each of those covers, by position in `order`
    """

    canvas: Rect
    dtype: np.dtype[Any]
    order: tuple[int, ...]
    patches: tuple[Patch, ...]


def gather_footprints(partial: PartialImage, order: Sequence[int], channel: Channel) -> Footprints:
    """Tell each other the footprints, leave out empty ones, and agree on what is wrong; collective.

    Raises
    ------
    InputError
        On every rank: an image with a wrong type or shape, images of different types, orders that are no permutation
        of the ranks or differ between ranks.
    """
    fault = _fault(partial, order, channel.size)
    name = "" if fault else partial.rgba.dtype.name
    reports = channel.allgather((partial.rect, name, tuple(order), fault))
    for rank, (_, _, other, text) in enumerate(reports):
        if text:
            raise mark_agreed(InputError(text, where=f"partial image of rank {rank}"))
        if other != reports[0][2]:
            raise mark_agreed(InputError(f"ranks 0 and {rank} give different visibility orders"))
    present = [rank for rank in order if reports[rank][0].pixels]
    names = {reports[rank][1] for rank in present} or {reports[0][1]}
    if len(names) > 1:
        raise mark_agreed(InputError("partial images differ in pixel type", found=", ".join(sorted(names))))
    canvas = EMPTY
    for rank in present:
        canvas = canvas.unite(reports[rank][0])
    patches = tuple(_on_canvas(reports[rank][0], canvas) for rank in present)
    return Footprints(canvas, np.dtype(names.pop()), tuple(present), patches)


def _fault(partial: PartialImage, order: Sequence[int], ranks: int) -> str:
    """What is wrong with this rank's arguments, or nothing."""
    if sorted(order) != list(range(ranks)):
        return f"the visibility order is no permutation of {ranks} ranks; found {list(order)}"
    if not isinstance(partial.rgba, np.ndarray) or partial.rgba.dtype not in DTYPES:
        found = getattr(partial.rgba, "dtype", type(partial.rgba).__name__)
        return f"wrong pixel type; found {found}; allowed float32, uint8"
    shape = (partial.rect.height, partial.rect.width, 4)
    if partial.rgba.shape != shape and partial.rect.pixels:
        return f"wrong shape; found {partial.rgba.shape}; allowed {shape}, as its rectangle says"
    return ""


def _on_canvas(rect: Rect, canvas: Rect) -> Patch:
    """A rectangle of the screen as a patch of the whole canvas."""
    x, y = canvas.x_begin, canvas.y_begin
    shifted = Rect(rect.x_begin - x, rect.y_begin - y, rect.x_end - x, rect.y_end - y)
    return Patch(canvas.width, 0, canvas.pixels, shifted)
