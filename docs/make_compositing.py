"""Write docs/compositing.md: the manuals of all algorithms as they stand in the code, with counts made by running it.

Run `python docs/make_compositing.py` after changing an algorithm; a test keeps the page equal to what this makes.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from clusterviz.composite import ALGORITHMS
from clusterviz.composite.model.network import open_network, shipped_networks
from clusterviz.composite.simulation.simulate import Options, count_load, simulate

PAGE = Path(__file__).with_name("compositing.md")
RANKS = (2, 3, 4, 5, 7, 8, 16, 31, 64)
MANY = (64, 1000, 4096)
BALANCED = (2, 4, 8, 16, 64)
SIZE = (4096, 4096)

HEAD = """# Compositing

Many ranks have each drawn a part of the data; compositing joins their images, front to back, into one. An algorithm is
a schedule: who sends which pixels to whom, in which round. This page is made from the code by
`python docs/make_compositing.py`. Below, n is the number of ranks, P the number of pixels, and all counts leave the
final gather apart. Choose with `-D cluster.compositing=NAME`; look at one with
`clusterviz simulate --ranks 7 --size 64x64 --algorithm NAME --draw schedule.svg`.
"""

NETWORKS = """## Networks

The prediction is T = rounds·α + messages·o + bytes·β + pixels·γ, the last three of the rank that has most of each (sent
or received, whichever is more; pixels received are those merged). A network file holds the four constants:
"""

FOOTPRINTS = """## Footprints

`--footprints dense`: every rank covers the whole picture. `--footprints cubes`: each rank has a brick of a cube seen
along its diagonal, and sends the bounding rectangle of what it holds, as the real exchange does. Pixels sent by all
ranks, divided by n^(1/3)·P, at 4096x4096:
"""

BALANCE = """Direct send chooses the borders of its pieces by the footprints. What the busiest rank receives of P, and
the messages of all ranks, beside pieces of equal size (`--bands 1`) and rows interlaced among owners (`--bands 4`):
"""


def text() -> str:
    """The whole page."""
    return "\n".join([HEAD, *_counts(), *_sparse(), *_predictions(), *_networks(), *_manuals()])


def _counts() -> Iterator[str]:
    yield "## Messages\n\nAll move (n − 1)·P pixels where images are dense. Their messages, rounds in brackets:\n"
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


def _predictions() -> Iterator[str]:
    yield "## Predicted seconds\n\nDense float32 images of 4096x4096, the final gather apart; for sparse images and"
    yield "from 2 to 65,536 ranks see [composite times](composite-times.md):\n"
    networks = [open_network(name) for name in shipped_networks()]
    ranks = (60, 4096)
    yield _row("algorithm", *(f"{network.name}, n = {n}" for network in networks for n in ranks))
    yield "|---" * (len(networks) * len(ranks) + 1) + "|"
    for name in ALGORITHMS:
        found = [simulate(name, n, SIZE, network).seconds for network in networks for n in ranks]
        yield _row(f"`{name}`", *(f"{seconds:.3g}" for seconds in found))
    yield ""


def _networks() -> Iterator[str]:
    yield NETWORKS
    yield _row("file", "α (s)", "o (s)", "β (s)", "γ (s)", "source")
    yield "|---" * 6 + "|"
    for name in shipped_networks():
        n = open_network(name)
        constants = (n.latency_seconds, n.overhead_seconds, n.seconds_per_byte, n.seconds_per_pixel)
        yield _row(f"`{name}`", *(f"{constant:g}" for constant in constants), n.source)
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
