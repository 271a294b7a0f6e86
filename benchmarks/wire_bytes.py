"""What travels: the bytes of every codec beside raw pixels and beside IceT.

    python benchmarks/wire_bytes.py --peers DIR --images FOLDER … [--codecs raw,active,…] [--algorithms …]

Bytes are those that all ranks send in one frame until the picture is whole on rank 0. IceT's counter includes what the
final gather sends; so does ours where the report tells it (`bytes_collected`), and a line below the table says so where
it does not. IceT's direct strategy sends every image to rank 0 at once: it has no gather, and its counterpart here is
serial. Times are no matter, so two frames are enough. Folders of images: compositors.py tells what they hold,
partial_images.py writes some, composite_icet.py has others made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from compositors import (
    ICET_ALGORITHMS,
    MPIS,
    Choice,
    Images,
    open_images,
    report,
    run_clusterviz,
    run_icet,
    wire_bytes,
)
from measuring import commas, options

FRAMES = 2
CODECS = ["raw", "active", "rectangle", "lz4", "shuffle+lz4", "delta+lz4", "rectangle+shuffle+lz4", "auto"]
ALGORITHMS = ["serial", "direct-send", "binary-swap"]


@dataclass(frozen=True)
class Row:
    """One algorithm on one folder of images: bytes by codec, and by IceT's algorithm."""

    case: str
    algorithm: str
    ours: dict[str, int]
    icet: dict[str, int]
    gather_counted: bool

    @property
    def cells(self) -> list[str]:
        """Megabytes of raw pixels; each codec as a share of them; the least over the least of IceT."""
        raw = self.ours["raw"]
        shares = [f"{sent / raw:.3f}" for codec, sent in self.ours.items() if codec != "raw"]
        least, fewest = min(self.ours, key=self.ours.__getitem__), min(self.icet, key=self.icet.__getitem__)
        icet, best = self.icet[fewest], f"{self.ours[least] / self.icet[fewest]:.2f} ({least})"
        return [self.case, self.algorithm, f"{raw / 1e6:.2f}", *shares, f"{icet / 1e6:.2f} ({fewest})", best]


def measure(images: Images, peers: Path, algorithms: Sequence[str], codecs: Sequence[str], mpi: str) -> list[Row]:
    """All algorithms and codecs on one folder of images."""
    icet = {name: int(run_icet(peers, images, name, FRAMES)["bytes_sent"]) for name in ICET_ALGORITHMS}
    rows = []
    for algorithm in algorithms:
        choices = [Choice(algorithm, codec, "messages") for codec in dict.fromkeys(["raw", *codecs])]
        reports = {choice.codec: run_clusterviz(images, choice, mpi, FRAMES) for choice in choices}
        counted = all("bytes_collected" in one for one in reports.values())
        ours = {codec: wire_bytes(one) for codec, one in reports.items()}
        rows.append(Row(images.title, algorithm, ours, icet, counted))
    return rows


def main() -> None:
    """Print the table."""
    asked = options(
        __doc__,
        peers={"type": Path, "required": True, "help": "the folder of icet.sh"},
        images={"type": Path, "nargs": "+", "required": True, "metavar": "FOLDER"},
        codecs={"type": commas(str), "default": CODECS},
        algorithms={"type": commas(str), "default": ALGORITHMS},
        mpi={"choices": MPIS, "default": "wheel"},
    )
    shares = [codec for codec in asked.codecs if codec != "raw"]
    head = ["images | ranks | pixels", "algorithm", "raw MB", *shares, "IceT MB, fewest", "ours, fewest / IceT"]
    how = (asked.algorithms, asked.codecs, asked.mpi)
    rows = report(asked, head, (measure(open_images(folder), asked.peers, *how) for folder in asked.images))
    if not all(row.gather_counted for row in rows):
        print("\nOurs without the final gather, which the reports do not count.")


if __name__ == "__main__":
    main()
