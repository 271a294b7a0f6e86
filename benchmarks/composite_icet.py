"""Time, error and bytes beside IceT, on the same images, in turn.

    python benchmarks/composite_icet.py --peers DIR [ALGORITHM/CODEC/TRANSPORT …] [--ranks 2,4,8] [--sides 1024,2048]

`--peers` names the peer's folder; see compositors.py. In each of several passes every algorithm of IceT and every
choice of ours runs once, by turns, each for `--frames` frames. The best algorithm of IceT counts. A ratio is ours over
IceT's: of the minima over all passes, and of the medians over the passes of each run's median. IceT runs under Open
MPI, ours under Open MPI and under the MPI of the wheel; the first is the comparison, the second what a user gets.
Other work on the machine spoils even ratios: the load is told at the end, and should be of these programs only.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product, zip_longest
from pathlib import Path
from statistics import median
from typing import Any

from compositors import (
    ICET_ALGORITHMS,
    MPIS,
    Choice,
    Images,
    cases_of,
    error_levels,
    options_of_images,
    parse_choice,
    report,
    run_clusterviz,
    run_icet,
    wire_bytes,
)
from measuring import options

GOALS = {"shared": 0.5, "messages": 1.0}  # of IceT's time; what is not named has the second
CHOICES = ("auto/auto/shared", "auto/auto/shared/copy", "auto/auto/messages")
AUTO_WITHIN = 1.15  # of the best fixed choice
HEAD = ("images | ranks | pixels", "MPI", "ours", "IceT, best", "ms", "ms (median)", "ratio", "ratio (median)")
HEAD_MORE = ("IceT error", "error", "IceT MB", "MB")


@dataclass(frozen=True)
class Runs:
    """All runs of one program on one case.

    Attributes
    ----------
    program : (MPI, choice) of ours, or ("", algorithm) of IceT
    min_ms : least of all frames
    median_ms : median over the passes of each pass's median
    levels : largest error of the picture, of 255
    bytes_sent : by all ranks in a frame
    """

    program: tuple[str, str]
    min_ms: float
    median_ms: float
    levels: float
    bytes_sent: int


@dataclass(frozen=True)
class Row:
    """One choice of ours beside the best of IceT, which may be another algorithm for the minimum and the median."""

    case: str
    ours: Runs
    icet: Runs
    ratio: float
    ratio_median: float

    @property
    def cells(self) -> list[str]:
        """The row of the table, columns as in HEAD."""
        ours, icet = self.ours, self.icet
        times = [f"{icet.min_ms:.2f} ({icet.program[1]})", f"{ours.min_ms:.2f}", f"{ours.median_ms:.2f}"]
        ratios = [f"{self.ratio:.2f}", f"{self.ratio_median:.2f}"]
        errors = [f"{icet.levels:.2f}", f"{ours.levels:.2f}"]
        sent = [f"{icet.bytes_sent / 1e6:.2f}", f"{ours.bytes_sent / 1e6:.2f}"]
        return [self.case, *ours.program, *times, *ratios, *errors, *sent]


def measure(images: Images, asked: argparse.Namespace) -> list[Row]:
    """All programs on one folder of images, by turns."""
    icet = [("", algorithm) for algorithm in asked.icet]
    ours = [(mpi, str(choice)) for mpi, choice in product(asked.mpi, asked.choices)]
    turns = [program for pair in zip_longest(icet, ours) for program in pair if program]
    reports: dict[tuple[str, str], list[dict[str, Any]]] = {program: [] for program in turns}
    levels = {}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "picture.rgba"
        for _ in range(asked.passes):
            for mpi, name in turns:
                if mpi:
                    found = run_clusterviz(images, parse_choice(name), mpi, asked.frames, out)
                else:
                    found = run_icet(asked.peers, images, name, asked.frames, out)
                reports[mpi, name].append(found)
                levels[mpi, name] = error_levels(out, images)
    runs = {program: summarise(program, reports[program], levels[program]) for program in turns}
    return [beside(images.title, runs[program], [runs[peer] for peer in icet]) for program in ours]


def summarise(program: tuple[str, str], reports: list[dict[str, Any]], levels: float) -> Runs:
    """One program's passes as one value."""
    sent = wire_bytes(reports[-1]) if program[0] else int(reports[-1]["bytes_sent"])
    least, middle = min(r["min_ms"] for r in reports), median(r["median_ms"] for r in reports)
    return Runs(program, least, middle, levels, sent)


def beside(case: str, ours: Runs, icet: list[Runs]) -> Row:
    """Ours over the best of IceT, for the minima and for the medians."""
    fastest = min(icet, key=lambda runs: runs.min_ms)
    ratio_median = ours.median_ms / min(runs.median_ms for runs in icet)
    return Row(case, ours, fastest, ours.min_ms / fastest.min_ms, ratio_median)


def goals(rows: list[Row]) -> Iterable[str]:
    """In how many cases each choice holds its goal."""
    for program in dict.fromkeys(row.ours.program for row in rows):
        mine = [row for row in rows if row.ours.program == program]
        goal = GOALS.get(parse_choice(program[1]).transport, GOALS["messages"])
        least, middle = sum(row.ratio <= goal for row in mine), sum(row.ratio_median <= goal for row in mine)
        worst = max(mine, key=lambda row: row.ratio)
        yield (
            f"- {program[1]}, {program[0]}: ≤ {goal:g} of IceT's time in {least} of {len(mine)} cases by minima, "
            f"{middle} by medians; worst {worst.ratio:.2f} ({worst.case.replace(' |', ',')})"
        )


def automatic(rows: list[Row]) -> Iterable[str]:
    """In how many cases the choice of `auto` is nearly the best of those measured with the same MPI."""
    name = str(Choice("auto", "auto", "auto"))
    for mpi in dict.fromkeys(row.ours.program[0] for row in rows):
        near = []
        for case in dict.fromkeys(row.case for row in rows):
            ms = {r.ours.program[1]: r.ours.min_ms for r in rows if r.case == case and r.ours.program[0] == mpi}
            if len(ms) > 1 and name in ms:
                near.append(ms[name] <= AUTO_WITHIN * min(value for key, value in ms.items() if key != name))
        if near:
            held = f"{sum(near)} of {len(near)} cases"
            yield f"- {name}, {mpi}: within {AUTO_WITHIN:g} times the best fixed choice in {held}"


def main() -> None:
    """Print the table and what holds."""
    choice = {"names": ["choices"], "nargs": "*", "type": parse_choice, "metavar": "ALGORITHM/CODEC/TRANSPORT"}
    mpis = {"nargs": "+", "choices": MPIS, "default": list(MPIS)}
    images = options_of_images([1024, 2048])
    asked = options(__doc__, choices=choice, **images, icet=list(ICET_ALGORITHMS), mpi=mpis, frames=30, passes=3)
    asked.choices, started = asked.choices or [parse_choice(text) for text in CHOICES], os.getloadavg()[0]
    rows = report(asked, [*HEAD, *HEAD_MORE], (measure(case, asked) for case in cases_of(asked)))
    load = f"- load {started:.1f} before, {os.getloadavg()[0]:.1f} after, {os.cpu_count()} cores"
    print("", *goals(rows), *automatic(rows), load, sep="\n")


if __name__ == "__main__":
    main()
