"""What a card does: one command that prints the table of frames beside VTK's, and writes it to a folder.

    python benchmarks/gpu.py FOLDER [--device N] [--python PYTHON_WITH_VTK] [--small] [--only NAME]…

Each row is an orbit of one degree a frame, drawn by `FrameLoop` in processes of its own: the median and the least
milliseconds of a frame from the camera to the picture in memory, its stages on the slowest rank, the calls of OpenGL
(`clusterviz.gl.device.Counts`) of the last frame on rank 0, and millions of samples a second of the frame. VTK draws
the same scene by `vtk_peer.py`, drawn and with the readback; without VTK in PYTHON_WITH_VTK its columns are empty.
A row that takes too long, or whose data cannot be fetched,
says so, and none begins after `--minutes`. `--small` runs all rows with little data, in two minutes on llvmpipe.
FOLDER receives gpu.md and gpu.json.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from measuring import PEER_PYTHON, beside, opened, options, picked, sample
from measuring import Row as Answer
from vtk_mappers_ratio import Arrays, cells, scene_of, sphere, synthetic, with_meshes
from vtk_raycast_ratio import FUNCTIONS, arrays_of

from clusterviz.comm import open_channel
from clusterviz.data.tetrahedra import make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.frame import FrameLoop, Options
from clusterviz.gl.device import Counts, Device
from clusterviz.scene.animation import orbit
from clusterviz.scene.overrides import with_settings

HD, UHD, SQUARE = (1920, 1080), (3840, 2160), (1024, 1024)
STAGES = ("plan", "render", "readback", "exchange", "collect")
EARLY_TERMINATION = 0.0039


@dataclass(frozen=True)
class Row:
    """A row of the table: the data, its size, and how it is drawn."""

    name: str
    data: str
    side: int
    picture: tuple[int, int]
    lit: bool = False
    ranks: int = 1
    filter: str = "exact"

    @property
    def scaled_down(self) -> Row:
        """The same with little data and a small picture."""
        width, height = self.picture
        return replace(self, side=max(8, self.side // 16), picture=(width // 12, height // 12))


ROWS = (
    Row("head", "head", 256, HD),
    Row("head", "head", 256, UHD),
    Row("head, lit", "head", 256, HD, lit=True),
    Row("head, filter: hardware", "head", 256, HD, filter="hardware"),
    Row("ball", "ball", 512, HD),
    Row("ball", "ball", 512, UHD),
    Row("ball", "ball", 1024, HD),
    Row("ball", "ball", 1024, UHD),
    Row("ball, lit", "ball", 1024, HD, lit=True),
    Row("ball, filter: hardware", "ball", 512, HD, filter="hardware"),
    Row("four transparent cortices", "cortices", 274, HD),
    Row("piston", "piston", 36, SQUARE),
    Row("ball on 2 ranks", "ball", 1024, HD, ranks=2),
    Row("ball on 4 ranks", "ball", 1024, HD, ranks=4),
)


def volume(row: Row) -> Arrays:
    """A head or a ball of waves with unit spacing."""
    voxels = picked(opened(sample())[1], *(row.side,) * 3) if row.data == "head" else synthetic(row.side)
    return arrays_of(voxels, FUNCTIONS["ramp"]) | {"step": 1.0, "shade": row.lit}


def cortices(row: Row) -> Arrays:
    """Four nested folded spheres of 4 · side² triangles."""
    meshes = []
    for number, radius in enumerate((100.0, 93.0, 86.0, 79.0)):
        vertices, triangles = sphere(radius, row.side)
        folds = np.sin(vertices[:, 0] / 6) * np.sin(vertices[:, 1] / 7) * np.sin(vertices[:, 2] / 8)
        folded = vertices * (1 + 0.03 * folds)[:, None].astype(np.float32)
        meshes.append(((folded, triangles), (0.9, 0.6 - 0.1 * number, 0.5 + 0.1 * number, 0.4)))
    return with_meshes([260, 180, 320], *meshes) | {"view_up": [0, 1, 0]}


def piston(row: Row) -> Arrays:
    """6 · side³ tetrahedra between two cylinders."""
    count = row.side + 1
    radius, around, along = np.meshgrid(*(np.linspace(0, 1, count) for _ in range(3)), indexing="ij")
    angle = 1.9 * np.pi * around
    points = np.stack([(1 + radius) * np.cos(angle), (1 + radius) * np.sin(angle), 2 * along], axis=-1).reshape(-1, 3)
    first = np.arange(count**3).reshape((count,) * 3)[:-1, :-1, :-1].reshape(-1, 1)
    x, y, z = count * count, count, 1
    ways = [(a, a + b) for a in (x, y, z) for b in (x, y, z) if a != b]
    corners = np.concatenate([first + np.array([0, a, ab, x + y + z]) for a, ab in ways])
    values = (np.sin(7 * radius) * np.cos(9 * along) + 1).astype(np.float32).ravel()
    return cells(make_tetrahedra(UnstructuredGrid("p", points.astype(np.float32), {"tetra": corners}, {"f": values})))


BUILDERS: dict[str, Callable[[Row], Arrays]] = {
    "head": volume,
    "ball": volume,
    "cortices": cortices,
    "piston": piston,
}


def turn(arrays: Path, picture: str, frames: int, device: int, filtering: str) -> None:
    """Draw an orbit on this rank; rank 0 prints one JSON line."""
    devices, made = list[Device](), Device.__init__

    def note(self: Device, *given: Any) -> None:
        made(self, *given)
        devices.append(self)

    def calls() -> Counts:
        return Counts(**{name: sum(getattr(one.counts, name) for one in devices) for name in asdict(Counts())})

    Device.__init__ = note  # type: ignore[method-assign]
    channel, begin = open_channel(), time.perf_counter()
    scene, shown = scene_of(dict(np.load(arrays)), 64)
    how = {"size": tuple(map(int, picture.split("x"))), "early_termination": EARLY_TERMINATION, "filter": filtering}
    scene = with_settings(scene, how).model_copy(update={"automatic": False})
    seconds, stages, counts = list[float](), list[dict[str, float]](), Counts()
    with FrameLoop(scene, channel, shown, Options(device=device)) as loop:
        scene = loop.scene
        for number, camera in enumerate(orbit(scene.camera, frames + 1.0, frames + 1)):
            before, started = calls(), time.perf_counter()
            found = loop.frame(scene.model_copy(update={"camera": camera}), number)
            seconds.append(time.perf_counter() - started if number else time.perf_counter() - begin)
            stages.append(found.statistics.seconds)
            counts = calls().since(before)
    if channel.rank:
        return
    samples, median = sum(rank.samples for rank in found.statistics.per_rank), statistics.median(seconds[1:])
    told = {name: statistics.median(one.get(name, 0.0) for one in stages[1:]) for name in STAGES}
    answer = {"first_s": seconds[0], "median_s": median, "least_s": min(seconds[1:]), "stages_s": told}
    answer |= {"samples": samples, "samples_per_second": samples / median, "renderer": found.statistics.renderer}
    print(json.dumps(answer | {"counts": asdict(counts) if devices else None}), flush=True)


def ask(command: list[Any], seconds: float) -> Answer:
    """Return the JSON that a command prints last, or the reason why it prints none."""
    try:
        ran = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        return {"failed": f"no end within {seconds:.0f} s"}
    lines = [line for line in ran.stdout.splitlines() if line.startswith("{")]
    if ran.returncode or not lines:
        said = (ran.stderr or ran.stdout).strip().splitlines() or ["nothing"]
        return {"failed": f"status {ran.returncode}: {said[-1][:200]}"}
    return dict(json.loads(lines[-1]))


def measure(row: Row, folder: Path, asked: argparse.Namespace, has_vtk: bool) -> Answer:
    """Draw a row here and with VTK."""
    try:
        np.savez(arrays := folder / "arrays.npz", **BUILDERS[row.data](row))
    except Exception as error:  # of the network, above all
        return {**asdict(row), "ours": {"failed": f"no data: {error}"}, "vtk": None}
    ranks = ["mpirun", "-n", row.ranks] if row.ranks > 1 else []
    size = "x".join(map(str, row.picture))
    words = [arrays, size, asked.frames, asked.device, row.filter]
    found: Answer = {**asdict(row), "vtk": None}
    found["ours"] = ask([*ranks, sys.executable, __file__, "--turn", *words], asked.patience)
    if has_vtk and row.data != "piston" and row.ranks == 1:
        command = [asked.python, beside("vtk_peer.py"), arrays, "gpu", size, asked.frames, folder / "peer.npy", "orbit"]
        found["vtk"] = ask(command, asked.patience)
    return found


HEAD = (
    "scene | size | median, least (ms) | first (s) | plan, render, readback, exchange, collect | "
    "dispatches, waits, made | MB up, read | 10⁶ samples/s | VTK drawn; with readback (ms) | ratio to these"
)


def cells_of(row: Answer) -> list[str]:
    ours, vtk, counts = row["ours"], row["vtk"] or {}, row["ours"].get("counts")
    head = [f"{row['name']} {row['side']}", "×".join(map(str, row["picture"]))]
    if "failed" in ours:
        return [*head, ours["failed"], *[""] * (HEAD.count("|") - 2)]
    ms = lambda seconds: f"{1e3 * seconds:.1f}"  # noqa: E731
    told = [vtk[name] for name in ("drawn_s", "median_s")] if "median_s" in vtk else []
    return [
        *head,
        f"{ms(ours['median_s'])}, {ms(ours['least_s'])}",
        f"{ours['first_s']:.1f}",
        ", ".join(ms(ours["stages_s"][name]) for name in STAGES),
        f"{counts['dispatches']}, {counts['waits']}, {counts['made']}" if counts else "–",
        f"{counts['uploaded'] / 1e6:.2f}, {counts['read'] / 1e6:.2f}" if counts else "–",
        f"{ours['samples_per_second'] / 1e6:.0f}",
        "; ".join(map(ms, told)) or vtk.get("failed", ""),
        ", ".join(f"{ours['median_s'] / one:.2f}" for one in told),
    ]


def _has(module: str, python: str) -> bool:
    return subprocess.run([python, "-c", f"import {module}"], capture_output=True).returncode == 0


def driver_of(device: int) -> str:
    code = f"from clusterviz.gl.context import open_context as o; i = o(0, {device}).info"
    ran = subprocess.run(
        [sys.executable, "-c", f"{code}; print(i['GL_RENDERER'], '|', i['GL_VERSION'])"], capture_output=True, text=True
    )
    return ran.stdout.strip() or "no OpenGL"


def parsed() -> argparse.Namespace:
    asked = options(
        __doc__,
        folder={"names": ["folder"], "nargs": "?", "type": Path, "default": Path("gpu")},
        device={"type": int, "default": 0, "help": "EGL's number"},
        python=PEER_PYTHON,
        small={"action": "store_true", "help": "little data, for trying this program"},
        only={"nargs": "*", "help": "rows whose names begin with one of these"},
        frames={"type": int, "help": "of an orbit; default: 20, small 3"},
        patience={"type": float, "default": 45.0, "help": "seconds for a row of one program"},
        minutes={"type": float, "default": 7.0, "help": "after which no row begins"},
        turn={"nargs": 5, "help": argparse.SUPPRESS},
    )
    asked.frames = asked.frames or (3 if asked.small else 20)
    return asked


def main() -> None:
    asked, begin = parsed(), time.perf_counter()
    if asked.turn:
        arrays, picture, frames, device, filtering = asked.turn
        return turn(Path(arrays), picture, int(frames), int(device), filtering)
    card, has_vtk = driver_of(asked.device), _has("vtkmodules.vtkRenderingVolumeOpenGL2", asked.python)
    lines = [f"{card}; {'VTK beside it' if has_vtk else 'no VTK here'}; medians of {asked.frames} frames", ""]
    lines += [f"| {HEAD} |", "|" + "---|" * (HEAD.count("|") + 1)]
    print(*lines, sep="\n", flush=True)
    rows = list[Answer]()
    with tempfile.TemporaryDirectory() as folder:
        for row in ROWS:
            if asked.only and not row.name.startswith(tuple(asked.only)):
                continue
            late = time.perf_counter() - begin > 60 * asked.minutes
            one = row.scaled_down if asked.small else row
            no_time: Answer = {**asdict(one), "ours": {"failed": "no time was left"}, "vtk": None}
            rows.append(no_time if late else measure(one, Path(folder), asked, has_vtk))
            lines.append(f"| {' | '.join(cells_of(rows[-1]))} |")
            print(lines[-1], flush=True)
    asked.folder.mkdir(parents=True, exist_ok=True)
    (asked.folder / "gpu.md").write_text("\n".join(lines) + "\n")
    report = {"card": card, "vtk": has_vtk, "frames": asked.frames, "rows": rows}
    (asked.folder / "gpu.json").write_text(json.dumps(report, indent=1) + "\n")
    return None


if __name__ == "__main__":
    main()
