"""The two compositors that the other programs compare, each as one job of several ranks on one folder of images.

A folder of images holds img_0.rgba, img_1.rgba, … (raw RGBA8, premultiplied, one a rank, front to back) and exact.npy:
float64 (h, w, 4), their composite. The peer is a folder with two programs:

- `icet.sh N WIDTH HEIGHT DIR ALGORITHM FRAMES [OUT.rgba]` prints JSON (median_ms, min_ms, bytes_sent of all ranks)
- `make_images.py N WIDTH HEIGHT DIR sparse|dense` writes such a folder
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from measuring import CLUSTERVIZ, commas, output_of, write
from numpy.typing import NDArray

from clusterviz.cli.jobs import find_mpirun

ICET_ALGORITHMS = ("bswap", "radixk", "tree", "direct", "auto")
MPIS = ("openmpi", "wheel")
# Ranks that spin while they wait take the cores from those that work; with more ranks than cores Open MPI must be told.
OPEN_MPI = ["mpirun.openmpi", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1"]
OPEN_MPI_ENVIRONMENT = {
    "MPI4PY_MPIABI": "openmpi",
    "MPI4PY_LIBMPI": "libmpi.so.40",
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
}
TIMEOUT_SECONDS = 300


@dataclass(frozen=True)
class Images:
    """A folder of images: what it shows, how many there are, and (width, height) of each."""

    folder: Path
    name: str
    ranks: int
    size: tuple[int, int]

    @property
    def title(self) -> str:
        """A line's first cells in a table: what, ranks, pixels."""
        return f"{self.name} | {self.ranks} | {self.size[0]} × {self.size[1]}"


@dataclass(frozen=True)
class Choice:
    """What `clusterviz bench composite` is told; written ALGORITHM/CODEC/TRANSPORT, or with /copy behind.

    With `copy`, shared memory is written within the time; else images lie in it already, as a read-back leaves them.
    """

    algorithm: str
    codec: str
    transport: str
    copy: bool = False

    def __str__(self) -> str:
        return "/".join((self.algorithm, self.codec, self.transport, *(["copy"] if self.copy else [])))


def parse_choice(text: str) -> Choice:
    """A choice as written on the command line; ValueError, which argparse reports, where it is none."""
    algorithm, codec, transport, *more = text.split("/")
    if more not in ([], ["copy"]):
        raise ValueError(f"{text}: only /copy may follow the transport")
    return Choice(algorithm, codec, transport, bool(more))


def open_images(folder: Path) -> Images:
    """What a folder holds: the ranks by counting files, the size from exact.npy, the name from the folder's."""
    height, width, _ = np.load(folder / "exact.npy", mmap_mode="r").shape
    return Images(folder, folder.name.split("-")[0], len(list(folder.glob("img_*.rgba"))), (width, height))


def made_images(peers: Path, parent: Path, kind: str, ranks: int, side: int) -> Images:
    """The peer's images of one kind (sparse or dense), made where they are missing."""
    folder = parent / f"{kind}-{ranks}-{side}"
    if not (folder / "exact.npy").exists():
        output_of([sys.executable, peers / "make_images.py", ranks, side, side, folder, kind], TIMEOUT_SECONDS)
    return open_images(folder)


def run_icet(peers: Path, images: Images, algorithm: str, frames: int, out: Path | None = None) -> dict[str, Any]:
    """IceT's report: median_ms and min_ms of the slowest rank; bytes_sent by all ranks, the final gather with them."""
    words = [peers / "icet.sh", images.ranks, *images.size, images.folder, algorithm, frames, *([out] if out else [])]
    report: dict[str, Any] = json.loads(output_of(words, TIMEOUT_SECONDS))
    return report


def run_clusterviz(
    images: Images, choice: Choice, mpi: str, frames: int, out: Path | None = None, extra: Sequence[str] = ()
) -> dict[str, Any]:
    """The report of `clusterviz bench composite` under an MPI of `MPIS`: its JSON."""
    launcher = OPEN_MPI if mpi == "openmpi" else [find_mpirun()]
    size = f"{images.size[0]}x{images.size[1]}"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "report.json"
        words = [*launcher, "-n", images.ranks, *CLUSTERVIZ, "bench", "composite"]
        words += ["--images", images.folder, "--size", size, "--algorithm", choice.algorithm, "--codec", choice.codec]
        words += ["--transport", choice.transport, "--frames", frames, "--json", file]
        words += ["--copy"] * choice.copy + list(extra)
        environment = OPEN_MPI_ENVIRONMENT if mpi == "openmpi" else {}
        output_of([*words, *(["--out", out] if out else [])], TIMEOUT_SECONDS, **environment)
        report: dict[str, Any] = json.loads(file.read_text())
    return report


def wire_bytes(report: dict[str, Any]) -> int:
    """Bytes that all ranks of ours sent, the final gather with them where the report counts it."""
    total: int = sum(report["bytes_sent"]) + sum(report.get("bytes_collected", ()))
    return total


def error_levels(out: Path, images: Images) -> float:
    """The largest difference of a picture (raw RGBA8) from the exact one, in levels of 1/255."""
    exact: NDArray[np.float64] = np.load(images.folder / "exact.npy")
    return float(np.abs(np.fromfile(out, np.uint8).reshape(exact.shape) - 255 * exact).max())


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; a cell may hold several, parted by " | "."""
    lines = [" | ".join(head), " | ".join("---" for cell in head for _ in cell.split(" | "))]
    return "\n".join(f"| {line} |" for line in [*lines, *(" | ".join(row) for row in rows)])


def options_of_images(sides: list[int]) -> dict[str, Any]:
    """The options that tell which images are composited."""
    made = Path(tempfile.gettempdir()) / "composite-images"
    return {
        "peers": {"type": Path, "required": True, "help": "the folder of icet.sh and make_images.py"},
        "images": {"type": Path, "nargs": "+", "default": [], "help": "folders of images, instead of made ones"},
        "made": made,
        "kinds": {"type": commas(str), "default": ["sparse", "dense"]},
        "ranks": {"type": commas(int), "default": [2, 4, 8]},
        "sides": {"type": commas(int), "default": sides},
    }


def cases_of(asked: argparse.Namespace) -> list[Images]:
    """The folders of images that are asked for."""
    if asked.images:
        return [open_images(folder) for folder in asked.images]
    wanted = product(asked.kinds, asked.sides, asked.ranks)
    return [made_images(asked.peers, asked.made, kind, ranks, side) for kind, side, ranks in wanted]


def report(asked: argparse.Namespace, head: Sequence[str], found: Iterable[Sequence[Any]]) -> list[Any]:
    """Print the rows of each case as soon as it is measured, write them on request, and return all."""
    print(table(head, []), flush=True)
    rows: list[Any] = []
    for some in found:
        rows += some
        print("\n".join(f"| {' | '.join(row.cells)} |" for row in some), flush=True)
    write(asked, rows=[asdict(row) for row in rows])
    return rows
