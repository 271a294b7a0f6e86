"""Patches of the canvas, fragments (a patch with its pixels), and the pixels that a rank owns after compositing.

The canvas is the union of all footprints. Its pixels are numbered row by row. A patch is the part of a rectangle whose
pixel numbers lie in a range; the rest of the range is blank, and neither stored nor sent. Pixel numbers grow along the
rows of the rectangle too, so a patch is one contiguous slice of the rectangle's rows, and cutting a range out of an
image never copies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clusterviz.codec.contract import Pixels
from clusterviz.image.partial import EMPTY, Rect, bounding_rect


@dataclass(frozen=True)
class Patch:
    """Pixels of `rect` (in canvas coordinates) whose numbers lie in [begin, end), on a canvas `width` wide."""

    width: int
    begin: int
    end: int
    rect: Rect
    first: int = field(init=False, compare=False)  # number of pixels of the rectangle before the range
    count: int = field(init=False, compare=False)  # number of pixels

    def __post_init__(self) -> None:
        # Counted once, as they are used often.
        first = self._before(self.begin)
        object.__setattr__(self, "first", first)
        object.__setattr__(self, "count", self._before(self.end) - first)

    def _before(self, number: int) -> int:
        rect = self.rect
        left, top, right, bottom = rect.x_begin, rect.y_begin, rect.x_end, rect.y_end
        if self.width == 0 or right <= left or bottom <= top:
            return 0
        row, column = divmod(number, self.width)
        if row < top:
            return 0
        width = right - left
        if row >= bottom:
            return (bottom - top) * width
        return (row - top) * width + min(max(column - left, 0), width)

    def cut(self, begin: int, end: int) -> Patch:
        """Return the part in [begin, end), a range inside this patch's own; the rectangle keeps its columns."""
        inside = Patch(self.width, begin, end, self.rect)
        if inside.count == 0:
            return Patch(self.width, begin, end, EMPTY)
        (top, first), (bottom, last) = divmod(begin, self.width), divmod(end - 1, self.width)
        # A row belongs to the cut only if the range reaches the rectangle's columns in it.
        top, bottom = top + (first >= self.rect.x_end), bottom + (last >= self.rect.x_begin)
        return Patch(self.width, begin, end, self.rect.intersect(Rect(self.rect.x_begin, top, self.rect.x_end, bottom)))


def unite(width: int, begin: int, end: int, patches: Sequence[Patch]) -> Patch:
    """Return the smallest patch of the range [begin, end) that contains all patches, on a canvas `width` wide."""
    return Patch(width, begin, end, bounding_rect(patch.rect for patch in patches)).cut(begin, end)


@dataclass(frozen=True, eq=False)
class Fragment:
    """A patch and its pixels.

    Pixels of the caller are read-only and never changed; received and merged pixels may be overwritten.
    """

    patch: Patch  # pixels of the canvas
    # float32, float16 or uint8 (patch.count, 4), premultiplied, C order; read-only if they are the caller's
    pixels: Pixels

    def cut(self, patch: Patch) -> Fragment:
        """Return the part in `patch`, a result of `Patch.cut`, without a copy."""
        if patch == self.patch:
            return self
        begin = patch.first - self.patch.first if patch.count else 0
        # `first` of the cut patch does not count the rows that its rectangle has lost above it.
        lost = (patch.rect.y_begin - self.patch.rect.y_begin) * self.patch.rect.width if patch.count else 0
        return Fragment(patch, self.pixels[begin + lost : begin + lost + patch.count])


@dataclass(frozen=True, eq=False)
class OwnedPixels:
    """Pixels that one rank owns after compositing; each pixel of the picture has one owner."""

    canvas: Rect  # rectangle of the screen on which pixels are numbered, the same on every rank
    dtype: np.dtype[Any]  # float32, float16 or uint8, the same on every rank
    fragments: tuple[Fragment, ...]  # owned ranges of the canvas with their pixels; empty on ranks that own nothing
    owners: tuple[int, ...]  # ranks of the channel that may own pixels; the rest of the picture is transparent
    # (owner, begin, end) of all owned ranges, ascending, if every rank knows them; the fragments then include blank
    # pixels. None if each owner has to send its own
    ranges: tuple[tuple[int, int, int], ...] | None = None
    disjoint: bool = False  # whether no two fragments overlap, so that blank pixels hide nothing
    picture: Pixels | None = None  # (height, width, 4), if the transport has written the whole picture on this rank
    gathered: bool = False  # whether the whole picture lies on one rank already; the same on every rank
