"""Patches of many ranks as columns: the arithmetic of `Patch` on whole arrays, to follow 10⁵ ranks at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules.schedule import Indices


@dataclass(frozen=True, eq=False)
class Rectangles:
    """One patch a row, on a canvas `width` × `height`.

    Attributes
    ----------
    begin, end : int64 (n,), the range of pixel numbers
    x_begin, y_begin, x_end, y_end : int64 (n,), the rectangle; an empty one is 0, 0, 0, 0
    """

    width: int
    height: int
    begin: Indices
    end: Indices
    x_begin: Indices
    y_begin: Indices
    x_end: Indices
    y_end: Indices

    @staticmethod
    def of_patches(patches: Sequence[Patch]) -> Rectangles:
        """The same patches, of which there is at least one, over the whole canvas."""
        width, height = patches[0].width, patches[0].end // max(patches[0].width, 1)
        rects = [p.rect for p in patches]
        rows = [(p.begin, p.end, r.x_begin, r.y_begin, r.x_end, r.y_end) for p, r in zip(patches, rects, strict=True)]
        columns = np.array(rows, np.int64).T
        empty = (columns[2] >= columns[4]) | (columns[3] >= columns[5])
        if empty.any():
            columns[2:, empty] = 0
        return Rectangles(width, height, *columns)

    def __len__(self) -> int:
        return len(self.begin)

    @property
    def canvas_pixels(self) -> int:
        """Pixels of the canvas."""
        return self.width * self.height

    def columns(self) -> tuple[Indices, ...]:
        """Begin, end, and the four sides."""
        return self.begin, self.end, self.x_begin, self.y_begin, self.x_end, self.y_end

    def take(self, index: Indices) -> Rectangles:
        """Some of the rows."""
        return Rectangles(self.width, self.height, *(column[index] for column in self.columns()))

    def count(self) -> Indices:
        """How many pixels each patch has."""
        return self._before(self.end) - self._before(self.begin)

    def cut(self, begin: Indices, end: Indices) -> Rectangles:
        """What each patch holds of a range that lies in its own, as `Patch.cut`."""
        inside = replace(self, begin=begin, end=end)
        top, first = np.divmod(begin, self.width)
        bottom, last = np.divmod(end - 1, self.width)
        top, bottom = top + (first >= self.x_end), bottom + (last >= self.x_begin)
        y_begin, y_end = np.maximum(self.y_begin, top), np.minimum(self.y_end, bottom)
        full = inside.count() > 0
        sides = (np.where(full, side, 0) for side in (self.x_begin, y_begin, self.x_end, y_end))
        return Rectangles(self.width, self.height, begin, end, *sides)

    def rows(self, first: int, last: int) -> tuple[Indices, Indices, Indices]:
        """Of the patches [first, last): the patch, and begin and end in pixel numbers, of each row of its rectangle."""
        heights = (self.y_end - self.y_begin)[first:last] * (self.x_end > self.x_begin)[first:last]
        patch = np.repeat(np.arange(first, last, dtype=np.int64), heights)
        row = np.arange(len(patch)) - np.repeat(np.cumsum(heights) - heights, heights) + self.y_begin[patch]
        return patch, row * self.width + self.x_begin[patch], row * self.width + self.x_end[patch]

    def _before(self, number: Indices) -> Indices:
        """Pixels of each rectangle before a number."""
        row, column = np.divmod(number, max(self.width, 1))
        wide, high = self.x_end - self.x_begin, self.y_end - self.y_begin
        part = np.clip(column - self.x_begin, 0, wide)
        found = np.where(row < self.y_begin, 0, (row - self.y_begin) * wide + part)
        return np.where(row >= self.y_end, wide * high, found)
