"""Time, error and bytes beside IceT; choices of `auto`; and whether codecs pay: on the same images, in turn.

    python benchmarks/composite_icet.py --peers DIR [ALGORITHM/CODEC/TRANSPORT …] [--ranks 2,4,8] [--sides 1024,2048]
    python benchmarks/composite_icet.py --what choices --peers DIR --mpi wheel
    python benchmarks/composite_icet.py --what codecs --images FOLDER … [--gbit 1] [--codecs raw,active,…]

`--peers` names the peer's folder; see compositors.py. In each of several passes every program runs once, by turns, each
for `--frames` frames. Times are the least of all frames, and the median over the passes of each run's median.

icet: every choice of ours over the best algorithm of IceT, which runs under Open MPI; ours under Open MPI, which is
the comparison, and under the MPI of the wheel, which users get.
choices: predicted and measured times of `auto` and of every fixed choice, with raw pixels. Run `clusterviz bench
network` first: predictions are made from the constants that it keeps.
codecs: time and bytes of each codec by direct send as a share of raw's, over a link slowed to `--gbit` and over the
machine's own; and of noise, which no codec makes smaller. With `--peers`, IceT's fewest bytes beside them.

Other work on the machine spoils even ratios: the load is told at the end, and should be of these programs only.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product, zip_longest
from pathlib import Path
from statistics import median
from typing import Any

from compositors import (
    ICET_ALGORITHMS,
    MPIS,
    Choice,
    Images,
    Runs,
    by_turns,
    made_images,
    open_images,
    parse_choice,
    run_clusterviz,
    run_icet,
    write_noise,
)
from measuring import Row, commas, options, show, write

from clusterviz.composite.schedules.radix_k import LARGEST_FACTOR

GOALS = {"shared": 0.5, "messages": 1.0}  # of IceT's time; what is not named has the second
CHOICES = ("auto/auto/shared", "auto/auto/shared/copy", "auto/auto/messages")
AUTOMATIC = ("auto/raw/messages", "auto/raw/auto")
NEAR = 1.15
"""Times the best fixed choice that `auto` may take."""


def ours_of(images: Images, choice: str, mpi: str, frames: int, extra: tuple[str, ...] = ()) -> Callable[[Path], Row]:
    return lambda out: run_clusterviz(images, parse_choice(choice), mpi, frames, out, extra)


def icet_of(images: Images, asked: argparse.Namespace) -> dict[str, Callable[[Path], Row]]:
    return {name: partial(run_icet, asked.peers, images, name, asked.frames) for name in asked.icet}


def beside_icet(images: Images, asked: argparse.Namespace) -> Iterator[Row]:
    """A row for each choice of ours: over the best of IceT, for the minima and for the medians."""
    peers = icet_of(images, asked)
    pairs = product(asked.mpi, asked.choices or CHOICES)
    ours = {f"{choice}, {mpi}": ours_of(images, choice, mpi, asked.frames) for mpi, choice in pairs}
    turns = [pair for both in zip_longest(peers.items(), ours.items()) for pair in both if pair]
    runs = by_turns(images, dict(turns), asked.passes)
    yield from (beside(images.title, name, runs[name], {peer: runs[peer] for peer in peers}) for name in ours)


def beside(case: str, name: str, ours: Runs, icet: dict[str, Runs]) -> Row:
    fastest = min(icet, key=lambda peer: icet[peer].min_ms)
    best = icet[fastest]
    return {
        "case": case,
        "program": name,
        "icet": fastest,
        "icet_ms": best.min_ms,
        "ms": ours.min_ms,
        "median_ms": ours.median_ms,
        "ratio": ours.min_ms / best.min_ms,
        "ratio_median": ours.median_ms / min(runs.median_ms for runs in icet.values()),
        "icet_levels": best.levels,
        "levels": ours.levels,
        "icet_bytes": best.bytes_sent,
        "bytes": ours.bytes_sent,
    }


def goals(rows: list[Row]) -> Iterator[str]:
    """In how many cases each choice holds its goal."""
    for program in dict.fromkeys(row["program"] for row in rows):
        mine = [row for row in rows if row["program"] == program]
        goal = GOALS.get(parse_choice(program.split(",")[0]).transport, GOALS["messages"])
        least, middle = (sum(row[key] <= goal for row in mine) for key in ("ratio", "ratio_median"))
        worst = max(mine, key=lambda row: row["ratio"])
        yield (
            f"- {program}: ≤ {goal:g} of IceT's time in {least} of {len(mine)} cases by minima, "
            f"{middle} by medians; worst {worst['ratio']:.2f} ({worst['case'].replace(' |', ',')})"
        )


def fixed(ranks: int) -> list[str]:
    """Every choice that differs from the others on so many ranks; pipelines and serial are for other purposes."""
    swaps = ["binary-swap", "binary-swap-telescope", "binary-swap-remainder", "2-3-swap"]
    # At powers of two all swaps are one; up to its largest factor radix-k is direct send.
    swaps = swaps[:1] if ranks & (ranks - 1) == 0 else swaps
    names = ["direct-send", *swaps, *(["radix-k"] if ranks > LARGEST_FACTOR else []), "tree"]
    return [*(f"{name}/raw/messages" for name in names), "auto/raw/shared"]


def choices(images: Images, asked: argparse.Namespace) -> Iterator[Row]:
    """A row for every choice: what was predicted, and what it took."""
    for mpi in asked.mpi:
        names = [*fixed(images.ranks), *AUTOMATIC]
        programs = {name: ours_of(images, name, mpi, asked.frames) for name in names}
        for name, runs in by_turns(images, programs, asked.passes).items():
            last = runs.reports[-1]
            row = {"case": f"{images.title} ({mpi})", "asked": name, "predicted_ms": last["predicted_ms"]}
            row |= {"ran": str(Choice(*(last[key] for key in ("algorithm", "codec", "transport"))))}
            row |= {"ms": runs.min_ms, "median_ms": runs.median_ms}
            yield row | {"off": last["predicted_ms"] / runs.min_ms}


def verdicts(rows: list[Row]) -> Iterator[str]:
    """For each kind of auto, how far from the best fixed choice of its kind, by the least times."""
    for name in AUTOMATIC:
        ratios, transport = [], parse_choice(name).transport
        for case in dict.fromkeys(row["case"] for row in rows):
            there = {row["asked"]: row for row in rows if row["case"] == case}
            others = [row for asked, row in there.items() if asked not in AUTOMATIC]
            others = [row for row in others if transport == "auto" or row["asked"].endswith(transport)]
            # What auto took is measured twice, as itself and as auto: the same program, so the same time but for noise.
            mine = next((row for row in others if row["ran"] == there[name]["ran"]), there[name])
            ratios.append(mine["ms"] / min(row["ms"] for row in others))
        near = sum(ratio <= NEAR for ratio in ratios)
        yield f"- {name}: within {NEAR:g} of the best in {near} of {len(ratios)} cases; worst {max(ratios):.2f}"
    errors = [max(row["off"], 1 / row["off"]) for row in rows]
    yield f"- predictions: off by a factor of {median(errors):.2f} (median), {max(errors):.2f} (worst)"


def codecs(images: Images, asked: argparse.Namespace) -> Iterator[Row]:
    """A row for each link: times and bytes as shares of raw's."""
    fewest = None
    if asked.peers:
        icet = by_turns(images, icet_of(images, asked), 1)
        fewest = min(runs.bytes_sent for runs in icet.values())
    for mpi, link in product(asked.mpi, (asked.gbit, "own")):
        extra = () if link == "own" else ("--link-gbit", link)
        names = dict.fromkeys(["raw", *asked.codecs])
        way = {name: ours_of(images, f"direct-send/{name}/messages", mpi, asked.frames, extra) for name in names}
        runs = by_turns(images, way, asked.passes)
        raw = runs.pop("raw")
        row = {"case": images.title, "link": link, "ms": raw.min_ms, "bytes": raw.bytes_sent, "icet_bytes": fewest}
        yield row | {
            name: f"{one.min_ms / raw.min_ms:.2f}, {one.bytes_sent / raw.bytes_sent:.3f}" for name, one in runs.items()
        }


def cases_of(asked: argparse.Namespace, folder: Path) -> Iterator[Images]:
    """The folders of images that are asked for, or made ones; and noise for codecs."""
    yield from map(open_images, asked.images)
    if asked.what == "codecs":
        ranks, side = map(int, asked.noise.split("x"))
        yield write_noise(folder, ranks, (side, side))
    elif not asked.images:
        made = Path(tempfile.gettempdir()) / "composite-images"
        for kind, side, ranks in product(asked.kinds, asked.sides, asked.ranks):
            yield made_images(asked.peers, made, kind, ranks, side)


def main() -> None:
    asked = options(
        __doc__,
        choices={"names": ["choices"], "nargs": "*", "metavar": "ALGORITHM/CODEC/TRANSPORT"},
        what={"choices": ("icet", "choices", "codecs"), "default": "icet"},
        peers={"type": Path, "help": "the folder of icet.sh and make_images.py"},
        images={"type": Path, "nargs": "+", "default": [], "help": "folders of images, instead of made ones"},
        kinds={"type": commas(str), "default": ["sparse", "dense"]},
        ranks={"type": commas(int), "default": [2, 4, 8]},
        sides={"type": commas(int), "default": [1024, 2048]},
        icet=list(ICET_ALGORITHMS),
        mpi={"nargs": "+", "choices": MPIS, "default": list(MPIS)},
        codecs={"type": commas(str), "default": ["active", "lz4", "shuffle+lz4", "delta+lz4", "auto"]},
        gbit={"default": "1", "help": "speed of the slowed link, 10⁹ bits a second"},
        noise={"default": "4x1024", "metavar": "RANKSxSIDE", "help": "how many images of noise, how large"},
        frames=30,
        passes=3,
    )
    needs_peers = asked.what == "icet" or (asked.what == "choices" and not asked.images)
    if (asked.peers or needs_peers) and not (asked.peers and (asked.peers / "icet.sh").exists()):
        raise SystemExit("composite_icet.py: --peers names no folder with icet.sh, which is no part of clusterviz")
    shares = [codec for codec in asked.codecs if codec != "raw"]
    tables: dict[str, tuple[Any, str, str]] = {
        "icet": (
            beside_icet,
            "ours | IceT, best | ms | ms (median) | ratio | ratio (median) | IceT error | error | IceT MB | MB",
            "{program} | {icet_ms:.2f} ({icet}) | {ms:.2f} | {median_ms:.2f} | {ratio:.2f} | {ratio_median:.2f} | "
            "{icet_levels:.2f} | {levels:.2f} | {icet_bytes!M:.2f} | {bytes!M:.2f}",
        ),
        "choices": (
            choices,
            "asked for | ran | predicted ms | median ms | least ms | predicted / least",
            "{asked} | {ran} | {predicted_ms:.2f} | {median_ms:.2f} | {ms:.2f} | {off:.2f}",
        ),
        "codecs": (
            codecs,
            " | ".join(["Gb/s", "raw ms", "raw MB", "IceT MB, fewest", *(f"{name}: time, bytes" for name in shares)]),
            " | ".join(["{link} | {ms:.2f} | {bytes!M:.2f} | {icet_bytes!M:.2f}", *(f"{{{name}}}" for name in shares)]),
        ),
    }
    measure, head, cells = tables[asked.what]
    started = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="noise-") as folder:
        rows = (row for case in cases_of(asked, Path(folder)) for row in measure(case, asked))
        found = show(f"images | ranks | pixels | {head}", f"{{case}} | {cells}", rows)
    told = {"icet": goals, "choices": verdicts}.get(asked.what, lambda rows: [])(found)
    print("", *told, f"- load {started:.1f} before, {os.getloadavg()[0]:.1f} after, {os.cpu_count()} cores", sep="\n")
    write(asked, rows=found)


if __name__ == "__main__":
    main()
