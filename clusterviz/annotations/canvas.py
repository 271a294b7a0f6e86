"""Canvas of lines, areas and text, drawn by Agg through matplotlib, and the overlay that it becomes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.errors import ClustervizError, installation

Colour = tuple[float, float, float]
Point = Sequence[float] | NDArray[np.float64]
Rect = tuple[float, float, float, float]
"""Left, top, right and bottom, pixels from the top left corner."""
FONT = "DejaVu Sans"
"""Font that matplotlib brings, so that pictures do not depend on the fonts of a machine."""
CAP_HEIGHT = 0.73
"""Height of a capital letter of the font, in font sizes."""
HALO_OPACITY = 0.95
SHORTEST = 3
"""Characters of a text that is cut, at least."""


def check_library() -> None:
    """Check early that text can be drawn. Raises ClustervizError: matplotlib is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ClustervizError(f"annotations need matplotlib: {installation('report')}") from None


@dataclass(frozen=True, eq=False)
class Overlay:
    """Pixels of an overlay that are not transparent."""

    index: NDArray[np.int64]  # int64 (n,), numbers of the pixels in the picture, row by row
    rgba: NDArray[np.float32]  # float32 (n, 4), premultiplied

    def blend_over(self, picture: NDArray[np.float32]) -> None:
        """Blend the overlay over a picture (h, w, 4), premultiplied, in place."""
        pixels = picture.reshape(-1, 4)
        pixels[self.index] = self.rgba + (1 - self.rgba[:, 3:]) * pixels[self.index]

    def blend_under(self, picture: NDArray[np.float32]) -> None:
        """Blend a picture (h, w, 4), premultiplied, over the overlay, in place."""
        pixels = picture.reshape(-1, 4)
        front = pixels[self.index]
        pixels[self.index] = front + (1 - front[:, 3:]) * self.rgba


class Canvas:
    """Canvas of a picture's size; positions are pixels from the top left corner, y down.

    `size`: width and height, pixels.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self._is_blank = True

    @cached_property
    def _renderer(self) -> Any:
        self._is_blank = False
        return _renderer(self.size)

    def lines(self, points: ArrayLike, colour: Colour, width: float, opacity: float = 1.0) -> None:
        """Draw polylines (n, k, 2) of equal width, pixels."""
        from matplotlib.path import Path

        polylines = np.asarray(points, np.float64)
        if not polylines.size:
            return
        codes = np.full(polylines.shape[:2], Path.LINETO, np.uint8)
        codes[:, 0] = Path.MOVETO
        self._draw(Path(self._flipped(polylines.reshape(-1, 2)), codes.ravel()), colour, width, opacity, None)

    def polygon(self, points: ArrayLike, fill: Colour | None, opacity: float = 1.0, edge: Colour | None = None) -> None:
        """Draw a polygon (k, 2); its edge is one pixel wide."""
        from matplotlib.path import Path

        corners = self._flipped(np.asarray(points, np.float64))
        path = Path(np.concatenate([corners, corners[:1]]), closed=True)
        if fill is not None:
            self._draw(path, fill, 0.0, opacity, (*fill, opacity))
        if edge is not None:
            self._draw(path, edge, 1.0, 1.0, None)

    def rectangle(self, rect: Rect, fill: Colour | None, edge: Colour | None = None) -> None:
        """Draw a rectangle."""
        left, top, right, bottom = rect
        self.polygon([(left, top), (right, top), (right, bottom), (left, bottom)], fill, edge=edge)

    def image(self, left: int, top: int, rgba: NDArray[np.uint8]) -> None:
        """Draw an image, uint8 (h, w, 4), straight alpha."""
        context = self._renderer.new_gc()
        flipped = np.ascontiguousarray(rgba[::-1])
        self._renderer.draw_image(context, left, self.size[1] - top - len(rgba), flipped)

    def text(
        self,
        at: Point,
        text: str,
        size: float,
        colour: Colour,
        align: Literal["left", "centre", "right"] = "left",
        *,
        vertical: bool = False,
        bold: bool = False,
    ) -> Rect:
        """Draw one line of text, centred in height at a point, or upwards, centred in width; return its rectangle.

        Text between dollar signs is matplotlib's mathematical notation.
        """
        rect = text_rect(at, text, size, align, vertical=vertical, bold=bold)
        context = self._renderer.new_gc()
        context.set_foreground(colour)
        left, _, right, bottom = rect
        inset = (bottom - rect[1] if not vertical else right - left) * (1 - CAP_HEIGHT) / 2
        start = (right - inset, bottom) if vertical else (left, bottom - inset)
        angle = 90.0 if vertical else 0.0
        # Unlike lines, text is placed from the top.
        self._renderer.draw_text(context, *start, text, _font(size, bold), angle, _is_math(text))
        return rect

    def overlay(self, halo: Colour | None = None, halo_width: float = 2.0) -> Overlay:
        """Return what was drawn, on a halo of this colour and width, pixels."""
        if self._is_blank:
            return Overlay(np.empty(0, np.int64), np.empty((0, 4), np.float32))
        drawn = np.asarray(self._renderer.buffer_rgba())
        opacity = np.ascontiguousarray(drawn[..., 3])
        around = opacity if halo is None else _dilated(opacity, max(1, round(halo_width)))
        index = np.flatnonzero(around != 0)
        straight = drawn.reshape(-1, 4)[index].astype(np.float32) / 255
        rgba = np.concatenate([straight[:, :3] * straight[:, 3:], straight[:, 3:]], axis=1)
        if halo is not None:
            # Thin strokes of small text do not cover a whole pixel.
            behind = np.minimum(2 / 255 * around.reshape(-1)[index].astype(np.float32)[:, None], 1) * HALO_OPACITY
            rgba += (1 - straight[:, 3:]) * behind * np.array([*halo, 1.0], np.float32)
        return Overlay(index, rgba)

    def _draw(self, path: Any, colour: Colour, width: float, opacity: float, fill: Any) -> None:
        from matplotlib.transforms import IdentityTransform

        context = self._renderer.new_gc()
        context.set_foreground(colour)
        context.set_alpha(opacity)
        context.set_linewidth(width)
        context.set_capstyle("round")
        context.set_joinstyle("round")
        self._renderer.draw_path(context, path, IdentityTransform(), fill)

    def _flipped(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return points * (1, -1) + (0, self.size[1])


def text_rect(
    at: Point,
    text: str,
    size: float,
    align: Literal["left", "centre", "right"] = "left",
    *,
    vertical: bool = False,
    bold: bool = False,
) -> Rect:
    """Return the rectangle of a line of text that `Canvas.text` draws; along y, `align` counts from the bottom."""
    width = text_width(text, size, bold=bold)
    x, y = (float(value) for value in at)
    before = {"left": 0.0, "centre": width / 2, "right": width}[align]
    if vertical:
        return x - size / 2, y + before - width, x + size / 2, y + before
    return x - before, y - size / 2, x - before + width, y + size / 2


@lru_cache(maxsize=4096)
def text_width(text: str, size: float, *, bold: bool = False) -> float:
    """Return the width of a line of text, pixels."""
    if not text:
        return 0.0
    width, _, _ = _renderer((1, 1)).get_text_width_height_descent(text, _font(size, bold), _is_math(text))
    return float(width)


def fitted_text(text: str, size: float, longest: float, *, bold: bool = False) -> tuple[str, float]:
    """Return a text and its size so that it is at most so long, pixels: smaller, by a quarter at most, then cut."""
    width = text_width(text, size, bold=bold)
    if width <= longest:
        return text, size
    size = max(0.75 * size, size * longest / width)
    while len(text) > SHORTEST and text_width(text, size, bold=bold) > longest:
        text = "…" if _is_math(text) else text[: min(len(text) - 2, int(len(text) * 0.95))].rstrip() + "…"
    return text, size


def overlap(a: Rect, others: Sequence[Rect]) -> bool:
    """Return whether a rectangle overlaps one of others."""
    return any(a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for b in others)


def _dilated(opacity: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """Return the maximum over a square of 2 width + 1 pixels."""
    columns = opacity.copy()
    for d in range(1, min(width, opacity.shape[0] - 1) + 1):
        np.maximum(columns[d:], opacity[:-d], out=columns[d:])
        np.maximum(columns[:-d], opacity[d:], out=columns[:-d])
    found = columns.copy()
    for d in range(1, min(width, opacity.shape[1] - 1) + 1):
        np.maximum(found[:, d:], columns[:, :-d], out=found[:, d:])
        np.maximum(found[:, :-d], columns[:, d:], out=found[:, :-d])
    return found


def _renderer(size: tuple[int, int]) -> Any:
    from matplotlib.backends.backend_agg import RendererAgg

    make: Any = RendererAgg
    return make(*size, 72.0)


@lru_cache(maxsize=64)
def _font(size: float, bold: bool) -> Any:
    from matplotlib.font_manager import FontProperties

    return FontProperties(family=FONT, size=size, weight="bold" if bold else "normal")


@lru_cache(maxsize=1024)
def _is_math(text: str) -> bool:
    """Return whether a text is mathematical notation that matplotlib can read."""
    from matplotlib.cbook import is_math_text
    from matplotlib.mathtext import MathTextParser

    if "$" not in text or not is_math_text(text):
        return False
    try:
        MathTextParser("path").parse(text)
    except ValueError:
        return False
    return True
