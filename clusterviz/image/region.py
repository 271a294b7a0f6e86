"""Rectangle of pixels."""

from __future__ import annotations

from dataclasses import dataclass


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


EMPTY = Rect(0, 0, 0, 0)
