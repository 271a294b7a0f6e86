"""Write docs/measurements/compositing-times.svg and .md: predicted times of all algorithms on the shipped networks.

Run `python docs/make_composite_times.py` after changing an algorithm or a network file; it takes some minutes, most of
them for the parallel pipeline. `--loads F.json` saves the counts, which do not depend on networks, and reads them the
next time. `--png F.png` writes the picture only, as PNG. `--most N` stops at N ranks.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.composite import ALGORITHMS
from clusterviz.composite.model.network import Network, open_network, shipped_networks
from clusterviz.composite.schedules.schedule import Load
from clusterviz.composite.simulation.simulate import MOST_RANKS, MOST_SPARSE_RANKS, Options, count_load

PICTURE = Path(__file__).with_name("measurements") / "compositing-times.svg"
PAGE = PICTURE.with_suffix(".md")
SIZE = (2048, 2048)
BYTES_PER_PIXEL = 16
KINDS = {"dense": "dense images", "cubes": "sparse images: bricks of a cube"}
# Ratio up to which two algorithms count as equally fast: no network agrees with a model more closely.
TIE = 1.1
# Of equally fast algorithms, the first is named.
STYLES = {
    "direct-send": ("#d62728", "-"),
    "radix-k": ("#9467bd", "-"),
    "2-3-swap": ("#17becf", "-"),
    "binary-swap": ("#1f77b4", "-"),
    "binary-swap-telescope": ("#1f77b4", "--"),
    "binary-swap-remainder": ("#1f77b4", ":"),
    "slic": ("#ff7f0e", "-"),
    "tree": ("#2ca02c", "-"),
    "parallel-pipeline": ("#8c564b", "--"),
    "pipeline": ("#8c564b", "-"),
    "serial": ("#7f7f7f", "-"),
}
# Seconds by number of ranks.
Curve = dict[int, float]

TEXT = """# Predicted compositing times, from 2 to 65,536 ranks

![Predicted seconds against ranks, all algorithms, three networks](compositing-times.svg)

Written by `python docs/make_composite_times.py` from predictions of `clusterviz simulate`: {width}x{height} pixels of
{bytes} bytes (float32), without the final gather, at 2, 3, 4, 6, 8, 12, … ranks. In the upper row every rank covers the
picture; in the lower row each has a brick of a cube. SLIC of sparse images is simulated up to {slic:,} ranks. The [time
model](../concepts/time-model.md) assumes that all links are used at once at full speed; a crowded network is slower.
"""

LESSON = """\
For dense images the number of messages makes the difference. For sparse images, algorithms that move no pixel twice
(direct send, SLIC) get faster with more ranks until their messages count. At 3·2^k ranks the fold makes binary swap up
to {fold:.1f} times as slow as 2-3 swap.

## Networks

`clusterviz bench network` measured the constants of `laptop`, with 2 ranks on 2 cores of a virtual machine (AMD EPYC,
Zen 4; MPICH). The others have the line rates of their networks and round figures for latency and overhead; the files
say where each constant is from.
"""


# By footprints and algorithm: the load of the busiest rank, by number of ranks; the same for all networks.
Loads = dict[tuple[str, str], dict[int, Load]]


def count_loads(most: int) -> Loads:
    """Return the loads of all algorithms up to `most` ranks."""
    found: Loads = {}
    for kind in KINDS:
        for name in ALGORITHMS:
            end = min(most, MOST_SPARSE_RANKS.get(name, MOST_RANKS) if kind == "cubes" else MOST_RANKS)
            # Bricks that are no regular grid make SLIC cut ever more cells.
            numbers = [n for n in rank_numbers(end) if name != "slic" or n < 3000 or n & (n - 1) == 0]
            found[kind, name] = {n: busiest(count_load(name, n, SIZE, kind, Options())[0]) for n in numbers}
    return found


def busiest(load: Load) -> Load:
    """Return a load of one rank that has the most of everything, which is all that the time model uses."""
    columns = (load.messages_sent, load.messages_received, load.pixels_sent, load.pixels_received)
    return Load(load.rounds, *(column.max(keepdims=True) for column in columns))


def kept_loads(path: Path, most: int) -> Loads:
    """Return the loads of a file, after writing it if it does not exist."""
    if not path.exists():
        counted = count_loads(most).items()
        rows = [
            [*key, n, load.rounds, *(int(c[0]) for c in list(vars(load).values())[1:])]
            for key, of in counted
            for n, load in of.items()
        ]
        path.write_text(json.dumps(rows), encoding="utf-8")
    found: Loads = {}
    for kind, name, n, rounds, *columns in json.loads(path.read_text(encoding="utf-8")):
        found.setdefault((kind, name), {})[n] = Load(rounds, *(np.array([column]) for column in columns))
    return found


def rank_numbers(most: int) -> list[int]:
    """Return powers of two, and 3/2 of each, where the swaps differ."""
    numbers = {2**k for k in range(1, 17)} | {3 * 2**k for k in range(15)}
    return sorted(number for number in numbers if number <= most)


def curves(kind: str, network: Network, loads: Loads) -> dict[str, Curve]:
    """Return the seconds of each algorithm."""
    return {
        name: {n: network.seconds(load, BYTES_PER_PIXEL) for n, load in found.items()}
        for (which, name), found in loads.items()
        if which == kind
    }


def draw(loads: Loads) -> Any:
    """Return the figure: a row for each kind of footprints, a column for each network."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "clusterviz", "font.size": 9})
    from matplotlib import pyplot as plt

    networks = [open_network(name) for name in shipped_networks()]
    figure, axes = plt.subplots(len(KINDS), len(networks), figsize=(11, 8.4), sharex=True, sharey="row")
    for row, kind in zip(axes, KINDS, strict=True):
        for axis, network in zip(row, networks, strict=True):
            found = curves(kind, network, loads)
            for name, (colour, dashes) in STYLES.items():
                curve = found[name]
                # Wide lines lie below the others, which are equally fast in many places.
                width = {"direct-send": 3.2, "slic": 1.8}.get(name, 1.1)
                axis.loglog(list(curve), list(curve.values()), dashes, color=colour, label=name, linewidth=width)
            axis.grid(which="major", color="#dddddd", linewidth=0.6)
            axis.set_title(f"{network.name}\n{KINDS[kind]}", fontsize=9)
    for axis, kind in zip(axes[:, 0], KINDS, strict=True):
        axis.set_ylabel("seconds")
        # Serial leaves the axes, or the others could not be told apart.
        shown = [curves(kind, network, loads) for network in networks]
        axis.set_ylim(top=2 * max(max(found["tree"].values()) for found in shown))
    for axis in axes[-1]:
        axis.set_xlabel("ranks")
        axis.set_xticks([2, 16, 128, 1024, 8192, 65_536], ["2", "16", "128", "1,024", "8,192", "65,536"])
        axis.minorticks_off()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=6, frameon=False)
    figure.tight_layout(rect=(0, 0.07, 1, 1))
    return figure


def text(loads: Loads) -> str:
    """Return the page: the figure, the fastest algorithms and the networks."""
    head = TEXT.format(width=SIZE[0], height=SIZE[1], bytes=BYTES_PER_PIXEL, slic=MOST_SPARSE_RANKS["slic"])
    rows = ["| network | images | fastest, or within a tenth of it, by number of ranks |", "|---|---|---|"]
    for name in shipped_networks():
        network = open_network(name)
        best = {kind: "; ".join(winners(curves(kind, network, loads))) for kind in KINDS}
        rows += [f"| {network.name} | {kind} | {found} |" for kind, found in best.items()]
    folds = [curves("dense", open_network(name), loads) for name in shipped_networks()]
    worst = max(found["binary-swap"][n] / seconds for found in folds for n, seconds in found["2-3-swap"].items())
    return "\n".join([head, *rows, "", LESSON.format(fold=worst), *networks()])


def networks() -> list[str]:
    """Return the table of network constants."""
    found = [open_network(name) for name in shipped_networks()]
    rows = ["| file | α (s) | o (s) | β (s) | γ (s) |", "|---|---|---|---|---|"]
    for name, n in zip(shipped_networks(), found, strict=True):
        constants = (n.latency_seconds, n.overhead_seconds, n.seconds_per_byte, n.seconds_per_pixel)
        rows.append(f"| `{name}` | {' | '.join(f'{constant:g}' for constant in constants)} |")
    return [*rows, ""]


def winners(found: Mapping[str, Curve]) -> list[str]:
    """Return runs of rank numbers with the same fastest algorithm; of equally fast ones, the first of `STYLES`."""
    best = []
    # Skip numbers that an algorithm left out between two others.
    left_out = {n for a in found.values() for n in a for b in found.values() if n not in b and n < max(b)}
    for number in sorted({n for curve in found.values() for n in curve} - left_out):
        seconds = {name: curve[number] for name, curve in found.items() if number in curve}
        fastest = min(seconds.values())
        best.append((number, next(name for name in STYLES if seconds.get(name, fastest * 9) <= fastest * TIE)))
    runs = [(name, [number for number, _ in run]) for name, run in groupby(best, key=lambda item: item[1])]
    return [f"{name} {span(numbers)}" for name, numbers in runs]


def span(numbers: Sequence[int]) -> str:
    """Return the first and the last number."""
    return f"{numbers[0]:,}" if len(numbers) == 1 else f"{numbers[0]:,} to {numbers[-1]:,}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=int, default=MOST_RANKS)
    parser.add_argument("--png")
    parser.add_argument("--loads", type=Path)
    arguments = parser.parse_args()
    loads = kept_loads(arguments.loads, arguments.most) if arguments.loads else count_loads(arguments.most)
    figure = draw(loads)
    if arguments.png:
        figure.savefig(arguments.png)
    else:
        figure.savefig(PICTURE, metadata={"Date": None})
        PAGE.write_text(text(loads), encoding="utf-8")
