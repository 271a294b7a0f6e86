"""A part of the picture and where it is not blank: a range of the linear pixel order, and a rectangle inside it.

The canvas is the union of all footprints, its pixels numbered row by row. A rank's pixels are the rectangle's pixels
whose number lies in the range; the rest of the range is blank, and neither stored nor sent. Since numbers grow along
the rows of the rectangle too, those pixels are one contiguous slice of the rectangle's own rows: cutting a range out
of an image, for sending it or for keeping it, never copies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from clusterviz.image.region import EMPTY, Rect


@dataclass(frozen=True)
class Patch:
    """The pixels of `rect` (in canvas coordinates) whose numbers lie in [begin, end), on a canvas `width` wide.

    Attributes
    ----------
    first : how many pixels of the rectangle come before the range
    count : how many pixels there are
    """

    width: int
    begin: int
    end: int
    rect: Rect
    first: int = field(init=False, compare=False)
    count: int = field(init=False, compare=False)

    def __post_init__(self) -> None:
        # Asked for at every turn, so counted once.
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
        """What this patch holds of the range [begin, end), which lies in its own; the rectangle keeps its columns."""
        inside = Patch(self.width, begin, end, self.rect)
        if inside.count == 0:
            return Patch(self.width, begin, end, EMPTY)
        (top, first), (bottom, last) = divmod(begin, self.width), divmod(end - 1, self.width)
        # A row belongs to the cut only if the range reaches the rectangle's columns in it.
        top, bottom = top + (first >= self.rect.x_end), bottom + (last >= self.rect.x_begin)
        return Patch(self.width, begin, end, self.rect.intersect(Rect(self.rect.x_begin, top, self.rect.x_end, bottom)))


def unite(width: int, begin: int, end: int, patches: Sequence[Patch]) -> Patch:
    """The smallest patch of the range [begin, end) that holds these, on a canvas `width` wide."""
    rect = EMPTY
    for patch in patches:
        rect = rect.unite(patch.rect)
    return Patch(width, begin, end, rect).cut(begin, end)
