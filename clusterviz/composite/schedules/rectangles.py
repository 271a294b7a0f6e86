"""Arrays of patches: the arithmetic of `Patch` for up to 10⁵ ranks at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules.schedule import Indices


@dataclass(frozen=True, eq=False)
class Rectangles:
    """Patches as columns, on a canvas of `width` × `height` pixels."""

    width: int
    height: int
    # int64 (n,), ranges of pixel numbers
    begin: Indices
    end: Indices
    # int64 (n,), rectangles; an empty one is 0, 0, 0, 0
    x_begin: Indices
    y_begin: Indices
    x_end: Indices
    y_end: Indices

    @staticmethod
    def of_patches(patches: Sequence[Patch]) -> Rectangles:
        """Return patches (at least one, with the whole canvas as range) as columns."""
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
        """Number of pixels of the canvas."""
        return self.width * self.height

    def columns(self) -> tuple[Indices, ...]:
        """Return begin, end, and the four sides."""
        return self.begin, self.end, self.x_begin, self.y_begin, self.x_end, self.y_end

    def take(self, index: Indices) -> Rectangles:
        """Return some of the patches, by index."""
        return Rectangles(self.width, self.height, *(column[index] for column in self.columns()))

    def count(self) -> Indices:
        """Return the number of pixels of each patch."""
        return self._before(self.end) - self._before(self.begin)

    def cut(self, begin: Indices, end: Indices) -> Rectangles:
        """Return the part of each patch in a range inside its own, as `Patch.cut`."""
        inside = replace(self, begin=begin, end=end)
        top, first = np.divmod(begin, self.width)
        bottom, last = np.divmod(end - 1, self.width)
        top, bottom = top + (first >= self.x_end), bottom + (last >= self.x_begin)
        y_begin, y_end = np.maximum(self.y_begin, top), np.minimum(self.y_end, bottom)
        full = inside.count() > 0
        sides = (np.where(full, side, 0) for side in (self.x_begin, y_begin, self.x_end, y_end))
        return Rectangles(self.width, self.height, begin, end, *sides)

    def rows(self, first: int, last: int) -> tuple[Indices, Indices, Indices]:
        """Return patch, begin and end (pixel numbers) of each row of the rectangles [first, last)."""
        heights = (self.y_end - self.y_begin)[first:last] * (self.x_end > self.x_begin)[first:last]
        patch = np.repeat(np.arange(first, last, dtype=np.int64), heights)
        row = np.arange(len(patch)) - np.repeat(np.cumsum(heights) - heights, heights) + self.y_begin[patch]
        return patch, row * self.width + self.x_begin[patch], row * self.width + self.x_end[patch]

    def _before(self, number: Indices) -> Indices:
        row, column = np.divmod(number, max(self.width, 1))
        wide, high = self.x_end - self.x_begin, self.y_end - self.y_begin
        part = np.clip(column - self.x_begin, 0, wide)
        found = np.where(row < self.y_begin, 0, (row - self.y_begin) * wide + part)
        return np.where(row >= self.y_end, wide * high, found)
