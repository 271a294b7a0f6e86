"""What does not depend on the camera: scalar bars, title, text, time stamp and legend, in places of their own.

The title is at the top. Time stamp, text and legend are in the upper left corner below it, scalar bars on the right.
Where the bars are on the left, the others are in the upper right corner.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.annotations.canvas import Canvas, Rect, fitted_text, text_width
from clusterviz.annotations.scalar_bar import Style, draw_scalar_bars
from clusterviz.content.contract import LegendEntry
from clusterviz.content.table import drawn_entries
from clusterviz.scene.annotations import Annotations, Legend, ScalarBar, TimeStamp, section_of
from clusterviz.scene.values import Scene

TITLE_SIZE = 1.4
LINE = 1.35
"""Distance of lines of text, in font sizes."""
SWATCH = 1.8
LONGEST_TITLE, LONGEST_TEXT = 0.9, 0.36
"""Longest title and text, as shares of the picture's width; what is longer is cut."""


def draw_fixed(
    canvas: Canvas, style: Style, settings: Annotations, contents: Sequence[LegendEntry], time: str
) -> tuple[Rect, ...]:
    """Draw everything that does not depend on the camera; return the rectangles that are in use."""
    width = canvas.size[0]
    rects: list[Rect] = []
    y = 0.8 * style.font
    for line in settings.title:
        text, size = fitted_text(line, TITLE_SIZE * style.font, LONGEST_TITLE * width, bold=True)
        y += 0.5 * LINE * TITLE_SIZE * style.font
        rects.append(canvas.text((width / 2, y), text, size, style.ink, "centre", bold=True))
        y += 0.5 * LINE * TITLE_SIZE * style.font
    bar = section_of(settings.scalar_bar, ScalarBar)
    if bar is not None:
        rects += draw_scalar_bars(canvas, style, bar, contents)
    legend = section_of(settings.legend, Legend)
    rows: list[tuple[str, LegendEntry | None]] = [
        (line, None) for line in ([time] if time else []) + list(settings.text)
    ]
    if legend is not None:
        labels = legend.labels
        rows += [(labels[n] if n < len(labels) else content.name, content) for n, content in enumerate(contents)]
    return (*rects, *_draw_rows(canvas, style, rows, y, bar is not None and bar.position == "left"))


def _draw_rows(
    canvas: Canvas, style: Style, rows: Sequence[tuple[str, LegendEntry | None]], y: float, on_right: bool
) -> list[Rect]:
    """Draw lines of text, with the colours of contents before them, from the top until the picture's middle."""
    (width, height), font = canvas.size, style.font
    longest = max(
        (text_width(text, font) + (SWATCH + 0.5) * font * (content is not None) for text, content in rows), default=0
    )
    start = width - font - min(longest, LONGEST_TEXT * width) if on_right else font
    rects = []
    for text, content in rows:
        y += 0.5 * LINE * font
        if y > 0.75 * height:
            break
        indent = 0.0 if content is None else (SWATCH + 0.5) * font
        shown, size = fitted_text(text, font, LONGEST_TEXT * width - indent)
        if content is not None:
            _draw_swatch(canvas, style, content, start, y)
        left, top, right, bottom = canvas.text((start + indent, y), shown, size, style.ink)
        rects.append((left - indent, top, right, bottom))
        y += 0.5 * LINE * font
    return rects


def _draw_swatch(canvas: Canvas, style: Style, content: LegendEntry, left: float, y: float) -> None:
    font, colours = style.font, content.colours
    top, bottom = y - 0.38 * font, y + 0.38 * font
    steps = np.linspace(left, left + SWATCH * font, len(colours) + 1)
    for colour, begin, end in zip(colours, steps[:-1], steps[1:], strict=True):
        canvas.rectangle((begin, top, end, bottom), tuple(colour))
    canvas.rectangle((left, top, left + SWATCH * font, bottom), None, edge=style.ink)


def time_text(scene: Scene) -> str:
    """Return the time stamp of a scene; "" if it has none, or no time steps."""
    stamp = section_of(scene.annotations.time, TimeStamp)
    if stamp is None:
        return ""
    times = [getattr(entry.section, "time", None) for entry in drawn_entries(scene)]
    found = next((time for time in times if isinstance(time, (int, float))), None)
    if found is None:
        return ""
    # A time with a decimal point is the time itself.
    return stamp.format.format(time=found if isinstance(found, float) else stamp.first + stamp.interval * found)
