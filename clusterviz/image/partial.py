"""Rectangles of pixels, and partial images: rectangles of premultiplied pixels that one rank drew."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Rect:
    """Pixels [x_begin, x_end) × [y_begin, y_end); row 0 is the top. Empty if an end is not past its begin."""

    x_begin: int
    y_begin: int
    x_end: int
    y_end: int

    @property
    def width(self) -> int:
        """Pixels in a row, 0 if empty."""
        return max(0, self.x_end - self.x_begin)

    @property
    def height(self) -> int:
        """Number of rows, 0 if empty."""
        return max(0, self.y_end - self.y_begin)

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.width * self.height

    def intersect(self, other: Rect) -> Rect:
        """Return the pixels in both rectangles."""
        return Rect(
            max(self.x_begin, other.x_begin),
            max(self.y_begin, other.y_begin),
            min(self.x_end, other.x_end),
            min(self.y_end, other.y_end),
        )

    def unite(self, other: Rect) -> Rect:
        """Return the smallest rectangle that contains both; an empty one adds nothing."""
        if self.pixels == 0:
            return other
        if other.pixels == 0:
            return self
        return Rect(
            min(self.x_begin, other.x_begin),
            min(self.y_begin, other.y_begin),
            max(self.x_end, other.x_end),
            max(self.y_end, other.y_end),
        )

    def slices_in(self, other: Rect) -> tuple[slice, slice]:
        """Return the rows and columns of these pixels in an array of another rectangle's, which holds them."""
        y, x = self.y_begin - other.y_begin, self.x_begin - other.x_begin
        return slice(y, y + self.height), slice(x, x + self.width)


EMPTY = Rect(0, 0, 0, 0)


def bounding_rect(rects: Iterable[Rect]) -> Rect:
    """Return the smallest rectangle that contains all rectangles; an empty one of none."""
    return reduce(Rect.unite, rects, EMPTY)


@dataclass(frozen=True)
class PartialImage:
    """Pixels that one rank drew; everything outside `rect` is fully transparent.

    Attributes
    ----------
    rgba : float32, float16 or uint8 (rect.height, rect.width, 4), premultiplied, C order
    """

    rect: Rect
    rgba: NDArray[np.float32] | NDArray[np.float16] | NDArray[np.uint8]


def blank() -> PartialImage:
    """Return an empty partial image."""
    return PartialImage(EMPTY, np.zeros((0, 0, 4), np.float32))


def joined(parts: Sequence[PartialImage]) -> PartialImage:
    """Return partial images that do not overlap as one of the first one's type, transparent between them."""
    rect = bounding_rect(part.rect for part in parts)
    if len(parts) == 1 or rect.pixels == 0:
        return parts[0] if parts else blank()
    rgba = np.zeros((rect.height, rect.width, 4), parts[0].rgba.dtype)
    for part in parts:
        y, x = part.rect.y_begin - rect.y_begin, part.rect.x_begin - rect.x_begin
        rgba[y : y + part.rect.height, x : x + part.rect.width] = part.rgba
    return PartialImage(rect, rgba)
