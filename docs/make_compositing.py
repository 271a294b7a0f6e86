"""Write docs/concepts/compositing.md: the manuals of all algorithms, with counts of their schedules.

Run `python docs/make_compositing.py` after changing an algorithm; a test compares the page with the code.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from clusterviz.composite import ALGORITHMS
from clusterviz.composite.model.network import open_network
from clusterviz.composite.simulation.simulate import Options, count_load, simulate

PAGE = Path(__file__).with_name("concepts") / "compositing.md"
RANKS = (3, 5, 8, 31, 64)
MANY = (64, 1000, 4096)
BALANCED = (2, 8, 64)
SIZE = (4096, 4096)

HEAD = """# Compositing

Each rank draws a part of the data. Compositing merges these partial images, front to back, into one picture. An
algorithm is a schedule: transfers of pixels between ranks, in rounds. The [time model](time-model.md) chooses one,
unless `cluster.compositing` names it. The [compositor](compositor.md) sends the pixels.

Below, n is the number of ranks and P the number of pixels. All algorithms work for any number of ranks and pixels.
Dense images cover the whole picture; for them, all algorithms send (n − 1)·P pixels in total, because each pixel needs
n − 1 merges. Counts do not include the final gather. This page is written by `python docs/make_compositing.py`, from
the docstrings of the algorithms and counts of their schedules.
"""

FOOTPRINTS = """## Sparse images

If each rank has a brick of a cube, seen along its diagonal, its image covers a part of the picture, and only the
bounding rectangle of its pixels is sent. Pixels sent by all ranks, divided by n^(1/3)·P, at 4096x4096:
"""

BALANCE = """Direct send chooses the borders of its pieces by the footprints. For these borders and others, the pixels
that the busiest rank receives, divided by P, with the messages of all ranks in brackets:
"""


def text() -> str:
    """The whole page."""
    return "\n".join([HEAD, *_counts(), *_sparse(), *_manuals()])


def _counts() -> Iterator[str]:
    yield "## Messages\n\nMessages of all ranks for dense images, with the number of rounds in brackets:\n"
    yield _row("algorithm", *(f"n = {ranks}" for ranks in RANKS))
    yield "|---" * (len(RANKS) + 1) + "|"
    for name, schedule in ALGORITHMS.items():
        counts = [schedule(ranks, SIZE[0] * SIZE[1], ()).counts() for ranks in RANKS]
        yield _row(f"`{name}`", *(f"{count.messages} ({count.rounds})" for count in counts))
    yield ""


def _sparse() -> Iterator[str]:
    names = ("direct-send", "radix-k", "binary-swap", "2-3-swap", "tree")
    network = open_network("laptop")
    yield FOOTPRINTS
    yield _row("algorithm", *(f"n = {ranks}" for ranks in MANY))
    yield "|---" * (len(MANY) + 1) + "|"
    canvas = SIZE[0] * SIZE[1] * 3**0.5 / 2
    for name in names:
        found = [simulate(name, ranks, SIZE, network, footprints="cubes") for ranks in MANY]
        yield _row(f"`{name}`", *(f"{made.pixels_sent / canvas / made.ranks ** (1 / 3):.2f}" for made in found))
    yield ""
    yield BALANCE
    yield _row("pieces", *(f"n = {ranks}" for ranks in BALANCED))
    yield "|---" * (len(BALANCED) + 1) + "|"
    for cut, bands in (("equal cover", None), ("equal size", 1), ("four bands each", 4)):
        loads = [count_load("direct-send", ranks, SIZE, "cubes", Options(bands=bands))[0] for ranks in BALANCED]
        yield _row(cut, *(f"{load.pixels_received.max() / canvas:.3f} ({load.messages_sent.sum()})" for load in loads))
    yield ""


def _manuals() -> Iterator[str]:
    for name, schedule in ALGORITHMS.items():
        manual = sys.modules[schedule.__module__].__doc__ or ""
        title, _, body = manual.strip().partition("\n\n")
        yield f"## `{name}`\n\n{title}\n"
        # Each item of a manual starts a line: "When: …".
        for item in re.split(r"\n(?=(?:When not|When|Cost|Limits|Reference)\b)", body):
            label, _, rest = item.partition(":")
            label, comma, case = label.partition(",")
            yield f"- **{label}**{comma}{case}: {' '.join(rest.split())}"
        yield ""


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    PAGE.write_text(text(), encoding="utf-8")
