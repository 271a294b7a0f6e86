"""Scalar bars: the colours of a transfer function with ticks, its opacity beside them, and two-dimensional tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.annotations.canvas import Canvas, Colour, Rect, fitted_text, text_width
from clusterviz.annotations.numbers import number_text, tick_labels, ticks
from clusterviz.content.contract import LegendEntry
from clusterviz.scene.annotations import ScalarBar
from clusterviz.scene.transfer import rescale
from clusterviz.scene.transfer_2d import TransferTable

# All lengths are in font sizes.
WIDTH, OPACITY_WIDTH, TICK, GAP, TITLE, SMALL = 1.1, 1.6, 0.3, 0.35, 1.5, 0.8
TABLE_SIDE = 8.0
LEAST_HEIGHT = 5.0
HEIGHT = 0.55
"""Height of a single bar, as a share of the picture's."""
TOP, BOTTOM = 0.12, {"right": 0.9, "left": 0.75}
"""Part of the picture's height that bars use; on the left, the orientation marker is below them."""
MOST_COLUMNS = 2


@dataclass(frozen=True)
class Style:
    """Colours and sizes of text and lines."""

    font: float  # size of text, pixels
    ink: Colour  # colour of text and lines
    halo: Colour  # colour around text

    @property
    def line(self) -> float:
        """Width of lines, pixels."""
        return max(1.0, 0.08 * self.font)


def draw_scalar_bars(canvas: Canvas, style: Style, settings: ScalarBar, contents: Sequence[LegendEntry]) -> list[Rect]:
    """Draw the bars of all contents with scalars in columns at a side of the picture; return their rectangles.

    Bars for which there is no room, in at most two columns, are left out.
    """
    titles = settings.title or ()
    known = [content for content in contents if content.transfer is not None]
    bars = [
        _Bar(content, titles[n] if n < len(titles) else content.name, settings, style)
        for n, content in enumerate(known)
    ]
    if not bars:
        return []
    width, height = canvas.size
    bottom = BOTTOM[settings.position]
    room = (bottom - TOP) * height
    rows = max(
        1,
        min(-(-len(bars) // MOST_COLUMNS) if len(bars) > 3 else len(bars), int(room / (LEAST_HEIGHT + 2) / style.font)),
    )
    slot = room / rows
    rects: list[Rect] = []
    edge = style.font
    for begin in range(0, min(len(bars), MOST_COLUMNS * rows), rows):
        column = bars[begin : begin + rows]
        tall = min(HEIGHT * height, slot - 3 * style.font)
        across = max(bar.measure(tall) for bar in column)
        if edge + across > 0.45 * width or tall < 2 * style.font:
            break
        left = width - edge - across if settings.position == "right" else edge
        for row, bar in enumerate(column):
            middle = (TOP + bottom) * height / 2 + (row - (len(column) - 1) / 2) * slot
            rects.append(bar.draw(canvas, left, middle))
        edge += across + style.font
    return rects


class _Bar:
    """One scalar bar."""

    def __init__(self, content: LegendEntry, title: str, settings: ScalarBar, style: Style) -> None:
        self._content, self._title, self._settings, self._style = content, title, settings, style
        assert content.transfer is not None
        self._transfer, self._table = content.transfer, content.table
        has_curve = bool(content.surfaces) or content.has_opacity
        self._has_opacity = settings.opacity and has_curve and content.table is None

    def measure(self, height: float) -> float:
        """Choose the ticks of a bar of this height, pixels; return the width of all."""
        font = self._style.font
        if self._table is not None:
            self._side = min(height, TABLE_SIDE * font)
            self._set_ticks(self._table.magnitudes, self._side)
            before = text_width(tick_labels(self._table.values)[0][0], font) / 2
            return before + self._side + (TICK + GAP) * font + self._longest + TITLE * font
        self._side = height
        self._set_ticks(self._transfer.domain, height)
        self._name, self._name_size = fitted_text(self._with_factor(self._title, self._factor), font, 1.2 * height)
        self._before = 0.0
        if self._has_opacity:
            inside = self._transfer.opacity(rescale(np.linspace(0, 1, 1024), self._transfer.domain)).max()
            surfaces = [alpha for _, alpha in self._content.surfaces]
            self._most = max([float(inside) if self._content.has_opacity else 0.0, *surfaces])
            of_text = text_width(_most_text(self._most), SMALL * font) - WIDTH * font
            self._before = max((OPACITY_WIDTH + 0.2) * font, of_text)
        return self._before + (WIDTH + TICK + GAP) * font + self._longest + (TITLE * font if self._name else 0.0)

    def draw(self, canvas: Canvas, left: float, middle: float) -> Rect:
        """Draw the bar; return its rectangle."""
        if self._table is not None:
            return self._draw_table(canvas, left, middle, self._table)
        style, font = self._style, self._style.font
        top, bottom = round(middle - self._side / 2), round(middle + self._side / 2)
        start = round(left + self._before)
        shares = 1 - (np.arange(bottom - top) + 0.5) / (bottom - top)
        scalars = rescale(shares, self._transfer.domain)
        wide = round(WIDTH * font)
        colours = np.repeat(_bytes(self._transfer.colour(scalars))[:, None], wide, axis=1)
        canvas.image(start, top, np.ascontiguousarray(colours))
        canvas.rectangle((start + 0.5, top + 0.5, start + wide - 0.5, bottom - 0.5), None, edge=style.ink)
        below = bottom + 0.0
        if self._has_opacity:
            below = self._draw_opacity(canvas, start, top, bottom, scalars)
        right = start + wide
        self._draw_ticks(canvas, right, top, bottom, self._transfer.domain)
        end = right + (TICK + GAP) * font + self._longest
        if self._name:
            canvas.text((end + 0.9 * font, middle), self._name, self._name_size, style.ink, "centre", vertical=True)
            end += TITLE * font
        return left, top - 0.5 * font, end, max(below, bottom + 0.5 * font)

    def _draw_opacity(self, canvas: Canvas, start: float, top: int, bottom: int, scalars: NDArray[np.float64]) -> float:
        """Draw the opacity to the left of the bar, relative to its maximum; return the lower end of its text."""
        style, content = self._style, self._content
        font = style.font
        opacity = self._transfer.opacity(scalars)
        edge, reach = start - 0.2 * font, OPACITY_WIDTH * font / (self._most or 1.0)
        heights = np.arange(top, bottom) + 0.5
        if content.has_opacity:
            curve = np.stack([edge - opacity * reach, heights], axis=1)
            canvas.polygon([(edge, top), *curve, (edge, bottom)], style.ink, 0.3)
            canvas.lines([curve], style.ink, style.line)
        for value, alpha in content.surfaces:
            y = bottom - _share(value, self._transfer.domain) * (bottom - top)
            if top <= y <= bottom:
                canvas.lines([[(edge - alpha * reach, y), (start + WIDTH * font, y)]], style.ink, 1.5 * style.line)
        canvas.lines([[(edge, top), (edge, bottom)]], style.ink, style.line, 0.5)
        y = bottom + 0.9 * font
        canvas.text((start + WIDTH * font, y), _most_text(self._most), SMALL * font, style.ink, "right")
        return y + 0.5 * font

    def _draw_table(self, canvas: Canvas, left: float, middle: float, table: TransferTable) -> Rect:
        """Draw a two-dimensional table: scalars to the right, magnitudes upwards, opacity relative to its maximum."""
        style, font, side = self._style, self._style.font, round(self._side)
        label = text_width(tick_labels(table.values)[0][0], font)
        start, top = round(left + label / 2), round(middle - side / 2)
        bottom = top + side
        shares = (np.arange(side) + 0.5) / side
        rows, columns = ((shares * n).astype(int) for n in table.opacities.shape)
        scalars = rescale(shares, table.values)
        colours = np.broadcast_to(self._transfer.colour(scalars), (side, side, 3))
        if table.colours is not None:
            colours = table.colours[rows[::-1]][:, columns]
        opacity = table.opacities[rows[::-1]][:, columns] / (table.opacities.max() or 1.0)
        canvas.image(
            start, top, np.concatenate([_bytes(colours)[..., :3], _bytes(opacity[..., None])[..., :1]], axis=2)
        )
        canvas.rectangle((start + 0.5, top + 0.5, start + side - 0.5, bottom - 0.5), None, edge=style.ink)
        self._draw_ticks(canvas, start + side, top, bottom, table.magnitudes)
        end = start + side + (TICK + GAP) * font + self._longest
        text, size = fitted_text(self._with_factor("gradient magnitude", self._factor), font, 1.3 * side)
        canvas.text((end + 0.9 * font, middle), text, size, style.ink, "centre", vertical=True)
        values = ticks(*table.values, min(self._settings.ticks, 1 + int(side / (label + 1.5 * font))))
        labels, factor = tick_labels(values)
        for value, text in zip(values, labels, strict=True):
            x = start + _share(value, table.values) * side
            canvas.lines([[(x, bottom), (x, bottom + TICK * font)]], style.ink, style.line)
            canvas.text((x, bottom + (TICK + 0.75) * font), text, font, style.ink, "centre")
        y = bottom + (TICK + 2.1) * font
        name, size = fitted_text(self._with_factor(self._title, factor), font, 1.3 * side)
        canvas.text((start + side / 2, y), name, size, style.ink, "centre")
        y += 1.2 * font
        canvas.text((start + side / 2, y), _most_text(float(table.opacities.max())), SMALL * font, style.ink, "centre")
        return left, top - 0.5 * font, end + TITLE * font, y + 0.5 * font

    def _set_ticks(self, domain: tuple[float, float], height: float) -> None:
        self._ticks = ticks(*domain, min(self._settings.ticks, max(2, int(height / (2 * self._style.font)))))
        self._labels, self._factor = tick_labels(self._ticks)
        self._longest = max((text_width(label, self._style.font) for label in self._labels), default=0.0)

    def _draw_ticks(self, canvas: Canvas, right: float, top: int, bottom: int, domain: tuple[float, float]) -> None:
        style, font = self._style, self._style.font
        for value, label in zip(self._ticks, self._labels, strict=True):
            y = bottom - _share(value, domain) * (bottom - top)
            canvas.lines([[(right, y), (right + TICK * font, y)]], style.ink, style.line)
            canvas.text((right + (TICK + GAP) * font, y), label, font, style.ink)

    def _with_factor(self, title: str, factor: str) -> str:
        return f"{title} ({factor})" if factor and title else title or factor


def _share(value: float, domain: tuple[float, float]) -> float:
    """Return where a value is in a domain, 0 to 1, without overflow; 0 if it is a single value."""
    low, high = (end / 2 for end in domain)
    return (value / 2 - low) / (high - low) if low < high else 0.0


def _most_text(most: float) -> str:
    return f"opacity ≤ {number_text(float(f'{most:.2g}'))}"


def _bytes(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return colours (…, 3) as opaque bytes (…, 4), or shares (…, 1) as bytes."""
    found: NDArray[np.uint8] = np.round(np.clip(values, 0, 1) * 255).astype(np.uint8)
    if found.shape[-1] == 1:
        return found
    return np.concatenate([found, np.full((*found.shape[:-1], 1), 255, np.uint8)], axis=-1)
