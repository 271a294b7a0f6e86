"""The two compositors that `composite_icet.py` compares, each as one job of several ranks on one folder of images.

A folder of images holds img_0.rgba, img_1.rgba, … (raw RGBA8, premultiplied, one a rank, front to back) and exact.npy:
float64 (h, w, 4), their composite. The peer is a folder with two programs:

- `icet.sh N WIDTH HEIGHT DIR ALGORITHM FRAMES [OUT.rgba]` prints JSON (median_ms, min_ms, bytes_sent of all ranks)
- `make_images.py N WIDTH HEIGHT DIR sparse|dense` writes such a folder
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np
from measuring import CLUSTERVIZ, Row, output_of
from numpy.typing import NDArray

from clusterviz.cli.jobs import find_mpirun
from clusterviz.reference.over import over

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


def write_noise(folder: Path, ranks: int, size: tuple[int, int]) -> Images:
    """Images of random bytes, premultiplied, all pixels visible: no codec makes them smaller."""
    rng = np.random.default_rng(3)
    layers = []
    for rank in range(ranks):
        alpha = rng.integers(1, 256, (size[1], size[0], 1))
        pixels = np.concatenate([rng.integers(0, alpha + 1, (size[1], size[0], 3)), alpha], axis=2).astype(np.uint8)
        pixels.tofile(folder / f"img_{rank}.rgba")
        layers.append(pixels / 255)
    np.save(folder / "exact.npy", over(layers))
    return open_images(folder)


def run_icet(peers: Path, images: Images, algorithm: str, frames: int, out: Path) -> Row:
    """IceT's report: median_ms and min_ms of the slowest rank; bytes_sent by all ranks, the final gather with them."""
    words = [peers / "icet.sh", images.ranks, *images.size, images.folder, algorithm, frames, out]
    report: Row = json.loads(output_of(words, TIMEOUT_SECONDS))
    return report


def run_clusterviz(images: Images, choice: Choice, mpi: str, frames: int, out: Path, extra: Sequence[str] = ()) -> Row:
    """The report of `clusterviz bench composite` under an MPI of `MPIS`: its JSON."""
    launcher = OPEN_MPI if mpi == "openmpi" else [find_mpirun()]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "report.json"
        words = [*launcher, "-n", images.ranks, *CLUSTERVIZ, "bench", "composite", "--images", images.folder]
        words += ["--size", "x".join(map(str, images.size)), "--algorithm", choice.algorithm, "--codec", choice.codec]
        words += ["--transport", choice.transport, "--frames", frames, "--json", file, "--out", out]
        environment = OPEN_MPI_ENVIRONMENT if mpi == "openmpi" else {}
        output_of([*words, *["--copy"] * choice.copy, *extra], TIMEOUT_SECONDS, **environment)
        report: Row = json.loads(file.read_text())
    return report


def wire_bytes(report: Row) -> int:
    """Bytes that all ranks sent, the final gather with them where the report counts it apart."""
    sent = report["bytes_sent"]
    return int(np.sum(sent)) + sum(report.get("bytes_collected", ()))


def error_levels(out: Path, images: Images) -> float:
    """The largest difference of a picture (raw RGBA8) from the exact one, in levels of 1/255."""
    exact: NDArray[np.float64] = np.load(images.folder / "exact.npy")
    return float(np.abs(np.fromfile(out, np.uint8).reshape(exact.shape) - 255 * exact).max())


@dataclass
class Runs:
    """All runs of one program on one folder of images, and the largest error of the last picture, of 255."""

    reports: list[Row] = field(default_factory=list)
    levels: float = 0.0

    @property
    def min_ms(self) -> float:
        """Least of all frames."""
        return min(float(one["min_ms"]) for one in self.reports)

    @property
    def median_ms(self) -> float:
        """Median over the passes of each pass's median."""
        return median(float(one["median_ms"]) for one in self.reports)

    @property
    def bytes_sent(self) -> int:
        """By all ranks in a frame of the last pass: what `auto` sends may change while it learns."""
        return wire_bytes(self.reports[-1])


def by_turns(images: Images, programs: dict[str, Callable[[Path], Row]], passes: int) -> dict[str, Runs]:
    """Run all programs in turn, some times; each gets the file for its picture and returns its report."""
    found = {name: Runs() for name in programs}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "picture.rgba"
        for _ in range(passes):
            for name, program in programs.items():
                found[name].reports.append(program(out))
                found[name].levels = error_levels(out, images)
    return found
