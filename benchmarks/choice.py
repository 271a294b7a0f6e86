"""How good the choices of `auto` are: predicted and measured times of auto and of every fixed choice, by turns.

    python benchmarks/choice.py --peers DIR [--ranks 2,4,8] [--sides 1024] [--mpi wheel] [--passes 3] [--json F]

`--peers` names the folder of make_images.py; see compositors.py. Run `clusterviz bench network` first: predictions are
made from the constants that it keeps. In each pass every choice runs once, by turns, all with raw pixels, so that
codecs do not blur what is compared. The times are the medians over the passes of each run's median, and the least of
all frames, which is what a prediction means: constants are measured by least times, too. `auto` may use any transport,
or messages only; each is put beside the best fixed choice of its kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from statistics import median

from compositors import MPIS, Choice, Images, cases_of, options_of_images, report, run_clusterviz
from measuring import options

from clusterviz.composite.schedules.radix_k import LARGEST_FACTOR

AUTOMATIC = (Choice("auto", "raw", "messages"), Choice("auto", "raw", "auto"))
HEAD = ("images | ranks | pixels", "asked for", "ran", "predicted ms", "median ms", "least ms", "predicted / least")
NEAR = 1.15


@dataclass(frozen=True)
class Row:
    """One choice on one folder of images."""

    case: str
    asked: str
    ran: str
    predicted_ms: float
    median_ms: float
    min_ms: float

    @property
    def cells(self) -> list[str]:
        """The row of the table, columns as in HEAD."""
        times = [f"{ms:.2f}" for ms in (self.predicted_ms, self.median_ms, self.min_ms)]
        return [self.case, self.asked, self.ran, *times, f"{self.predicted_ms / self.min_ms:.2f}"]


def fixed(ranks: int) -> tuple[Choice, ...]:
    """Every choice that differs from the others on so many ranks; pipelines and serial are for other purposes."""
    swaps = ["binary-swap", "binary-swap-telescope", "binary-swap-remainder", "2-3-swap"]
    # At powers of two all swaps are one; up to its largest factor radix-k is direct send.
    swaps = swaps[:1] if ranks & (ranks - 1) == 0 else swaps
    names = ["direct-send", *swaps, *(["radix-k"] if ranks > LARGEST_FACTOR else []), "tree"]
    return (*(Choice(name, "raw", "messages") for name in names), Choice("auto", "raw", "shared"))


def measure(images: Images, mpi: str, frames: int, passes: int) -> list[Row]:
    """Every choice on one folder of images, by turns."""
    choices = (*fixed(images.ranks), *AUTOMATIC)
    reports = [[run_clusterviz(images, choice, mpi, frames) for choice in choices] for _ in range(passes)]
    rows = []
    for choice, found in zip(choices, zip(*reports, strict=True), strict=True):
        ran = str(Choice(*(found[-1][key] for key in ("algorithm", "codec", "transport"))))
        middle, least = median(one["median_ms"] for one in found), min(one["min_ms"] for one in found)
        rows.append(Row(f"{images.title} ({mpi})", str(choice), ran, found[-1]["predicted_ms"], middle, least))
    return rows


def verdicts(rows: list[Row]) -> list[str]:
    """For each kind of auto, how far from the best fixed choice of its kind, by the least times."""
    lines = []
    for choice in AUTOMATIC:
        ratios = []
        for case in dict.fromkeys(row.case for row in rows):
            there = {row.asked: row for row in rows if row.case == case}
            # What auto took is measured twice, as itself and as auto: the same program, so the same time but for noise.
            automatic = [str(other) for other in AUTOMATIC]
            others = [row for asked, row in there.items() if asked not in automatic]
            others = [row for row in others if choice.transport == "auto" or row.asked.endswith(choice.transport)]
            mine = next((row for row in others if row.ran == there[str(choice)].ran), there[str(choice)])
            ratios.append(mine.min_ms / min(row.min_ms for row in others))
        near = sum(ratio <= NEAR for ratio in ratios)
        lines.append(
            f"- {choice}: within {NEAR:g} of the best in {near} of {len(ratios)} cases; worst {max(ratios):.2f}"
        )
    errors = [max(row.predicted_ms / row.min_ms, row.min_ms / row.predicted_ms) for row in rows]
    return [*lines, f"- predictions: off by a factor of {median(errors):.2f} (median), {max(errors):.2f} (worst)"]


def main() -> None:
    """Print the table and what it says."""
    mpis = {"nargs": "+", "choices": MPIS, "default": ["wheel"]}
    asked = options(__doc__, **options_of_images([1024]), mpi=mpis, frames=30, passes=3)
    cases = product(cases_of(asked), asked.mpi)
    rows = report(asked, HEAD, (measure(*case, asked.frames, asked.passes) for case in cases))
    print("", *verdicts(rows), sep="\n")


if __name__ == "__main__":
    main()
