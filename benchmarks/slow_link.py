"""Whether a codec pays: times over a link slowed to 1 Gb/s, and over the machine's own.

    python benchmarks/slow_link.py --images FOLDER … [--gbit 1] [--codecs raw,active,…] [--algorithm direct-send]

Each codec's time is told as a share of raw's, the least of all frames of several passes that take turns. Beside the
folders that are given, noise is measured: no codec makes it smaller, so `auto` should send it raw. Off means that
auto sent exactly as many bytes as raw, part that it packed some of the messages.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from compositors import MPIS, Choice, Images, open_images, report, run_clusterviz, wire_bytes
from measuring import commas, options

from clusterviz.reference.over import over

CODECS = ["raw", "active", "lz4", "shuffle+lz4", "delta+lz4", "auto"]


@dataclass(frozen=True)
class Row:
    """Milliseconds and bytes by codec, on one folder of images over one link."""

    case: str
    link: str
    min_ms: dict[str, float]
    bytes_sent: dict[str, int]

    @property
    def cells(self) -> list[str]:
        """Raw's time, each codec's as a share of it, and what auto did."""
        raw = self.min_ms["raw"]
        shares = [f"{ms / raw:.2f}" for codec, ms in self.min_ms.items() if codec != "raw"]
        return [self.case, self.link, f"{raw:.2f}", *shares, self.told]

    @property
    def told(self) -> str:
        """What auto did to the bytes; "" where it was not measured."""
        if "auto" not in self.bytes_sent:
            return ""
        share = self.bytes_sent["auto"] / self.bytes_sent["raw"]
        return "off" if share == 1 else f"{share:.2f} of the bytes"


def write_noise(folder: Path, ranks: int, size: tuple[int, int]) -> Images:
    """Images of random bytes, premultiplied, all pixels visible."""
    rng = np.random.default_rng(3)
    layers = []
    for rank in range(ranks):
        alpha = rng.integers(1, 256, (size[1], size[0], 1))
        pixels = np.concatenate([rng.integers(0, alpha + 1, (size[1], size[0], 3)), alpha], axis=2).astype(np.uint8)
        pixels.tofile(folder / f"img_{rank}.rgba")
        layers.append(pixels / 255)
    np.save(folder / "exact.npy", over(layers))
    return open_images(folder)


def measure(images: Images, link: str, codecs: Sequence[str], asked: argparse.Namespace) -> Row:
    """All codecs on one folder of images, by turns; `link` in Gb/s, or "own"."""
    extra = [] if link == "own" else ["--link-gbit", link]
    reports: dict[str, list[dict[str, Any]]] = {codec: [] for codec in dict.fromkeys(["raw", *codecs])}
    for _ in range(asked.passes):
        for codec, found in reports.items():
            choice = Choice(asked.algorithm, codec, "messages")
            found.append(run_clusterviz(images, choice, asked.mpi, asked.frames, extra=extra))
    least = {codec: min(one["min_ms"] for one in found) for codec, found in reports.items()}
    # What auto sends may change while it learns; the last pass's last frame counts.
    return Row(images.title, link, least, {codec: wire_bytes(found[-1]) for codec, found in reports.items()})


def main() -> None:
    """Print the table."""
    asked = options(
        __doc__,
        images={"type": Path, "nargs": "+", "required": True, "metavar": "FOLDER"},
        gbit={"default": "1", "help": "speed of the slowed link, 10⁹ bits a second"},
        codecs={"type": commas(str), "default": CODECS},
        algorithm="direct-send",
        mpi={"choices": MPIS, "default": "wheel"},
        frames=20,
        passes=2,
        noise={"default": "4x1024", "metavar": "RANKSxSIDE", "help": "how many images of noise, how large"},
    )
    shares = [codec for codec in asked.codecs if codec != "raw"]
    with tempfile.TemporaryDirectory(prefix="noise-") as folder:
        ranks, side = map(int, asked.noise.split("x"))
        cases = [*map(open_images, asked.images), write_noise(Path(folder), ranks, (side, side))]
        found = ([measure(*case, asked.codecs, asked)] for case in product(cases, (asked.gbit, "own")))
        report(asked, ["images | ranks | pixels", "Gb/s", "raw ms", *shares, "auto sent"], found)


if __name__ == "__main__":
    main()
