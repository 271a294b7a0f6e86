"""Drawing of a schedule: a column for each stage, a line for each transfer from its source's row to its target's."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path

from clusterviz.composite.schedules.schedule import Schedule
from clusterviz.errors import InputError
from clusterviz.image.replace import replacing

MOST_RANKS = 64
MOST_TRANSFERS = 5000
ROW, COLUMN, MARGIN = 18, 110, 46
COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf")


@dataclass(frozen=True)
class Line:
    """Line of a transfer: ends and width in pixels, colour, and tooltip."""

    begin: tuple[float, float]
    end: tuple[float, float]
    width: float
    colour: str
    text: str


def write_drawing(schedule: Schedule, path: str, title: str) -> None:
    """Draw a schedule into an .svg or .png file.

    Raises InputError for another kind of file, too many transfers, or a path that cannot be written.
    """
    check_drawable(schedule.ranks, path)
    number = sum(len(stage) for stage in schedule.stages)
    if number > MOST_TRANSFERS:
        text = "too many transfers to draw; take fewer ranks"
        raise InputError(text, where=path, found=number, allowed=f"up to {MOST_TRANSFERS}")
    with replacing(path) as temporary:
        if Path(path).suffix.lower() == ".svg":
            temporary.write_text(svg(schedule, title), encoding="utf-8")
        else:
            _write_png(schedule, title, temporary)


def check_drawable(ranks: int, path: str) -> None:
    """Raise if a schedule of this many ranks cannot be drawn into this file.

    Raises InputError for another kind of file than .svg and .png, or too many ranks.
    """
    kind = Path(path).suffix.lower()
    if kind not in (".svg", ".png"):
        raise InputError("a schedule cannot be drawn into such a file", where=path, found=kind, allowed=".svg, .png")
    if ranks > MOST_RANKS:
        raise InputError("too many ranks to draw", where=path, found=ranks, allowed=f"up to {MOST_RANKS}")


def lines(schedule: Schedule) -> list[Line]:
    """Return one line for each transfer; its width grows with the fraction of the picture that it carries."""
    found = []
    for number, stage in enumerate(schedule.stages):
        left, right = MARGIN + number * COLUMN, MARGIN + (number + 1) * COLUMN - 12
        for t in stage:
            share = (t.end - t.begin) / max(schedule.pixels, 1)
            text = f"round {number + 1}: {t.source} to {t.target}, pixels [{t.begin}, {t.end})"
            colour = COLOURS[t.source % len(COLOURS)]
            found.append(Line((left, _row(t.source)), (right, _row(t.target)), 0.6 + 3 * share, colour, text))
    return found


def svg(schedule: Schedule, title: str) -> str:
    """Return the drawing as SVG text; each line has a tooltip."""
    width, height = _paper(schedule)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" '
        'font-size="11">',
        '<rect width="100%" height="100%" fill="white"/>',
        f'<text x="{MARGIN}" y="18" font-size="13">{escape(title)}</text>',
    ]
    for x, y, text in _labels(schedule):
        parts.append(f'<text x="{x}" y="{y + 4}" text-anchor="middle" fill="#555">{text}</text>')
    for line in lines(schedule):
        (x1, y1), (x2, y2) = line.begin, line.end
        parts.append(
            f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="{line.colour}" stroke-width="{line.width:.2f}">'
            f"<title>{line.text}</title></line>"
        )
    return "\n".join([*parts, "</svg>", ""])


def _write_png(schedule: Schedule, title: str, path: Path) -> None:
    from PIL import Image, ImageDraw

    image = Image.new("RGB", _paper(schedule), "white")
    draw = ImageDraw.Draw(image)
    draw.text((MARGIN, 8), title, fill="black")
    for x, y, text in _labels(schedule):
        draw.text((x, y), text, fill="#555555", anchor="mm")
    for line in lines(schedule):
        draw.line([line.begin, line.end], fill=line.colour, width=max(1, round(line.width)))
    image.save(path)


def _labels(schedule: Schedule) -> list[tuple[int, int, str]]:
    right = MARGIN + len(schedule.stages) * COLUMN
    ranks = [(x, _row(rank), str(rank)) for rank in range(schedule.ranks) for x in (MARGIN - 16, right + 4)]
    middles = (MARGIN + number * COLUMN + COLUMN // 2 - 6 for number in range(len(schedule.stages)))
    return ranks + [(x, 34, f"round {number + 1}") for number, x in enumerate(middles)]


def _paper(schedule: Schedule) -> tuple[int, int]:
    return max(2 * MARGIN + len(schedule.stages) * COLUMN, 320), _row(schedule.ranks) + ROW


def _row(rank: int) -> int:
    return 54 + rank * ROW
