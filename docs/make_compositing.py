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
from clusterviz.composite.schedules.algorithms import SEVERAL_IMAGES
from clusterviz.composite.simulation.simulate import simulate

PAGE = Path(__file__).with_name("concepts") / "compositing.md"
RANKS = (3, 8, 31, 64)
MANY = (64, 1000, 4096)
SIZE = (4096, 4096)

HEAD = """# Compositing

Compositing merges the partial images of all ranks, front to back, into one picture. An algorithm is a schedule:
transfers of pixels between ranks, in rounds. The [time model](time-model.md) chooses one, unless `cluster.compositing`
names it. The [compositor](compositor.md) sends the pixels.

Below, n is the number of ranks and P the number of pixels; both may be any number. {several}
take any number of partial images a rank, in any order; the others one, or several that are adjacent in depth.
`python docs/make_compositing.py` writes this page from counts of the schedules, without the final gather, and from the
docstrings of the algorithms, which also have the costs as formulas.
"""

COUNTS = """## Messages

Of dense images, which cover the whole picture, all algorithms send (n − 1)·P pixels in total. Messages of all ranks,
with the number of rounds in brackets:
"""

FOOTPRINTS = """## Sparse images

If each rank has a brick of a cube, seen along its diagonal, only the bounding rectangle of its pixels is sent. Pixels
sent by all ranks, divided by n^(1/3)·P, at 4096x4096:
"""

ITEMS = ("What", "When", "When not", "Reference")


def text() -> str:
    """The whole page."""
    names = [f"`{name}`" for name in ALGORITHMS if name in SEVERAL_IMAGES]
    several = f"{', '.join(names[:-1])} and {names[-1]}"
    return "\n".join([HEAD.format(several=several), *_counts(), *_sparse(), *_manuals()])


def _counts() -> Iterator[str]:
    yield COUNTS
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


def _manuals() -> Iterator[str]:
    for name, schedule in ALGORITHMS.items():
        manual = sys.modules[schedule.__module__].__doc__ or ""
        title, _, body = manual.strip().partition("\n\n")
        yield f"## `{name}`\n\n{title}\n"
        # Each item of a manual starts a line: "When: …".
        for item in re.split(r"\n(?=(?:When not|When|Cost|Limits|Reference)\b)", body):
            label, _, rest = item.partition(":")
            if label in ITEMS:
                yield f"- **{label}**: {' '.join(rest.split())}"
        yield ""


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    PAGE.write_text(text(), encoding="utf-8")
