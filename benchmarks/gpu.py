"""What a card does: one command that prints the table of frames beside VTK's, and writes it to a folder.

    python benchmarks/gpu.py FOLDER [--device N] [--python PYTHON_WITH_VTK] [--tests] [--small] [--only NAME]…

Each row is an orbit of one degree a frame, drawn by `FrameLoop` in processes of its own: the median and the least
milliseconds of a frame from the camera to the picture in memory, its stages on the slowest rank, the calls of OpenGL
(`clusterviz.gl.device.Counts`) of the last frame on rank 0, and millions of samples a second of the frame. VTK draws
the same scene by `vtk_peer.py`, drawn and with the readback; without VTK in PYTHON_WITH_VTK its columns are empty.
`--tests` runs the tests marked gl and not mpi at the end. A row that takes too long, or whose data cannot be fetched,
says so, and none begins after `--minutes`. `--small` runs all rows with little data, in two minutes on llvmpipe.
FOLDER receives gpu.md and gpu.json.
"""

from __future__ import annotations

import argparse
import json
import os
import re
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
from vtk_peeling_ratio import sphere, write_ply
from vtk_raycast_ratio import equivalent_scene, synthetic, write_peer_scene

from clusterviz.comm import open_channel
from clusterviz.frame import FrameLoop, Options
from clusterviz.gl.device import Counts, Device
from clusterviz.scene import Scene, load_scene
from clusterviz.scene.overrides import with_settings

HD, UHD, SQUARE = (1920, 1080), (3840, 2160), (1024, 1024)
STAGES = ("plan", "render", "readback", "exchange", "collect")
STEP, EARLY_TERMINATION = 1.0, 0.0039
TESTS = ["-m", "pytest", "-m", "gl and not mpi", "tests/gl", "tests/render", "-p", "no:cacheprovider"]


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


def volume_scene(row: Row, folder: Path) -> tuple[Scene, Path | None]:
    """Write a volume; return its scene, and what vtk_peer.py needs to draw it."""
    path = folder / f"{row.data}-{row.side}.npy"
    if not path.exists():
        np.save(path, picked(opened(sample())[1], *(row.side,) * 3) if row.data == "head" else synthetic(row.side))
    scene = equivalent_scene(path, (row.side,) * 3, 64, STEP, EARLY_TERMINATION)
    volumes = tuple(one.model_copy(update={"shade": row.lit}) for one in scene.volumes)
    scene = with_settings(scene, {"filter": row.filter}).model_copy(update={"volumes": volumes})
    write_peer_scene(peer := folder / "peer.npz", scene, np.load(path), STEP)
    return scene, peer


def mesh_scene(row: Row, folder: Path) -> tuple[Scene, Path | None]:
    """Write four nested folded spheres of 4 · side² triangles."""
    sections, arrays = [], {}
    for number, radius in enumerate((100.0, 93.0, 86.0, 79.0)):
        vertices, triangles = sphere(radius, row.side)
        folds = np.sin(vertices[:, 0] / 6) * np.sin(vertices[:, 1] / 7) * np.sin(vertices[:, 2] / 8)
        vertices *= (1 + 0.03 * folds)[:, None]
        rgba = (0.9, 0.6 - 0.1 * number, 0.5 + 0.1 * number, 0.4)
        write_ply(path := folder / f"cortex-{number}.ply", vertices, triangles)
        sections.append({"path": str(path), "color": rgba[:3], "opacity": rgba[3], "shade": False})
        arrays |= {f"vertices_{number}": vertices, f"triangles_{number}": triangles, f"rgba_{number}": rgba}
    camera = {"position": [260, 180, 320], "focal_point": [0, 0, 0], "view_up": [0, 1, 0], "view_angle": 30}
    np.savez(peer := folder / "cortices.npz", **arrays, **camera)
    return Scene(meshes=sections, camera=camera), peer  # type: ignore[arg-type]


def grid_scene(row: Row, folder: Path) -> tuple[Scene, Path | None]:
    """Write 6 · side³ tetrahedra between two cylinders, as a file of VTK."""
    count = row.side + 1
    radius, around, along = np.meshgrid(*(np.linspace(0, 1, count) for _ in range(3)), indexing="ij")
    angle = 1.9 * np.pi * around
    points = np.stack([(1 + radius) * np.cos(angle), (1 + radius) * np.sin(angle), 2 * along], axis=-1).reshape(-1, 3)
    first = np.arange(count**3).reshape((count,) * 3)[:-1, :-1, :-1].reshape(-1, 1)
    x, y, z = count * count, count, 1
    ways = [(a, a + b) for a in (x, y, z) for b in (x, y, z) if a != b]
    corners = np.concatenate([first + np.array([0, a, ab, x + y + z]) for a, ab in ways])
    values = np.sin(7 * radius) * np.cos(9 * along) + 1
    cells = np.column_stack([np.full(len(corners), 4), corners]).astype(">i4")
    path = folder / "piston.vtk"
    path.write_bytes(
        b"# vtk DataFile Version 3.0\npiston\nBINARY\nDATASET UNSTRUCTURED_GRID\n"
        + f"POINTS {len(points)} float\n".encode()
        + points.astype(">f4").tobytes()
        + f"\nCELLS {len(cells)} {cells.size}\n".encode()
        + cells.tobytes()
        + f"\nCELL_TYPES {len(cells)}\n".encode()
        + np.full(len(cells), 10, ">i4").tobytes()
        + f"\nPOINT_DATA {len(points)}\nSCALARS f float 1\nLOOKUP_TABLE default\n".encode()
        + values.astype(">f4").tobytes()
    )
    camera = {"position": [6, 4, 8], "focal_point": [0, 0, 1], "view_up": [0, 0, 1], "view_angle": 30}
    return Scene(grids=({"path": str(path)},), camera=camera), None  # type: ignore[arg-type]


BUILDERS: dict[str, Callable[[Row, Path], tuple[Scene, Path | None]]] = {
    "head": volume_scene,
    "ball": volume_scene,
    "cortices": mesh_scene,
    "piston": grid_scene,
}


def orbit(scene_file: Path, frames: int, device: int) -> None:
    """Draw an orbit on this rank; rank 0 prints one JSON line."""
    devices, made = list[Device](), Device.__init__

    def note(self: Device, *given: Any) -> None:
        made(self, *given)
        devices.append(self)

    Device.__init__ = note  # type: ignore[method-assign]
    channel, begin = open_channel(), time.perf_counter()
    scene = load_scene(scene_file).model_copy(update={"automatic": False})
    seconds, stages, counts = list[float](), list[dict[str, float]](), Counts()
    with FrameLoop(scene, channel, None, Options(device=device)) as loop:
        scene = loop.scene
        for number in range(frames + 1):
            before, started = _sum(devices), time.perf_counter()
            found = loop.frame(_turned(scene, number), number)
            seconds.append(time.perf_counter() - started if number else time.perf_counter() - begin)
            stages.append(found.statistics.seconds)
            counts = _sum(devices).since(before)
    if channel.rank:
        return
    samples, median = sum(rank.samples for rank in found.statistics.per_rank), statistics.median(seconds[1:])
    told = {name: statistics.median(one.get(name, 0.0) for one in stages[1:]) for name in STAGES}
    answer = {"first_s": seconds[0], "median_s": median, "least_s": min(seconds[1:]), "stages_s": told}
    answer |= {"samples": samples, "samples_per_second": samples / median, "renderer": found.statistics.renderer}
    print(json.dumps(answer | {"counts": asdict(counts) if devices else None}), flush=True)


def _sum(devices: list[Device]) -> Counts:
    """Return the calls of all devices together."""
    return Counts(**{name: sum(getattr(one.counts, name) for one in devices) for name in asdict(Counts())})


def _turned(scene: Scene, degrees: int) -> Scene:
    """Return the scene with its camera turned about the vertical through the focal point."""
    centre, angle = np.array(scene.camera.focal_point), np.deg2rad(degrees)
    up = np.array(scene.camera.view_up) / np.linalg.norm(scene.camera.view_up)
    arm = np.array(scene.camera.position) - centre
    turned = arm * np.cos(angle) + np.cross(up, arm) * np.sin(angle) + up * (up @ arm) * (1 - np.cos(angle))
    camera = scene.camera.model_copy(update={"position": tuple((centre + turned).tolist())})
    return scene.model_copy(update={"camera": camera})


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
        scene, peer = BUILDERS[row.data](row, folder)
    except Exception as error:  # of the network, above all
        return {**asdict(row), "ours": {"failed": f"no data: {error}"}, "vtk": None}
    size = scene.image.model_copy(update={"size": row.picture, "background": "black"})
    path = folder / "scene.json"
    path.write_text(scene.model_copy(update={"image": size}).model_dump_json())
    ranks = ["mpirun", "-n", row.ranks] if row.ranks > 1 else []
    ours = [*ranks, sys.executable, __file__, "--orbit", path, "--frames", asked.frames, "--device", asked.device]
    found: Answer = {**asdict(row), "ours": ask(ours, asked.patience), "vtk": None}
    if has_vtk and peer and row.ranks == 1:
        size, out = "x".join(map(str, row.picture)), folder / "peer.npy"
        command = [asked.python, beside("vtk_peer.py"), peer, "gpu", size, asked.frames, out, "orbit"]
        found["vtk"] = ask(command, asked.patience)
    return found


HEADER = (
    "scene",
    "size",
    "median, least (ms)",
    "first (s)",
    ", ".join(STAGES),
    "dispatches, waits, made",
    "MB up, read",
    "10⁶ samples/s",
    "VTK drawn; with readback (ms)",
    "ratio to these",
)


def cells_of(row: Answer) -> list[str]:
    """Return the cells of a row of the table."""
    ours, vtk, counts = row["ours"], row["vtk"] or {}, row["ours"].get("counts")
    head = [f"{row['name']} {row['side']}", "×".join(map(str, row["picture"]))]
    if "failed" in ours:
        return [*head, ours["failed"], *[""] * (len(HEADER) - 3)]
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


def run_tests(seconds: float) -> str:
    """Return the last line of the tests that need OpenGL and no MPI, on as many cores as there are."""
    cores = ["-n", str(len(os.sched_getaffinity(0)))] if _has("xdist", sys.executable) else []
    root, command = Path(__file__).parents[1], [sys.executable, *TESTS, *cores]
    try:
        ran = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        return f"no end within {seconds:.0f} s"
    return (re.findall(r"=+ (.*(?:passed|failed|error).*) =+", ran.stdout) or ["no summary"])[-1]


def _has(module: str, python: str) -> bool:
    return subprocess.run([python, "-c", f"import {module}"], capture_output=True).returncode == 0


def driver_of(device: int) -> str:
    """Return the names of a device and of its driver."""
    code = f"from clusterviz.gl.context import open_context as o; i = o(0, {device}).info"
    ran = subprocess.run(
        [sys.executable, "-c", f"{code}; print(i['GL_RENDERER'], '|', i['GL_VERSION'])"], capture_output=True, text=True
    )
    return ran.stdout.strip() or "no OpenGL"


def parsed() -> argparse.Namespace:
    """Return the options."""
    asked = options(
        __doc__,
        folder={"names": ["folder"], "nargs": "?", "type": Path, "default": Path("gpu")},
        device={"type": int, "default": 0, "help": "EGL's number"},
        python=PEER_PYTHON,
        small={"action": "store_true", "help": "little data, for trying this program"},
        tests={"action": "store_true", "help": "run the tests that need OpenGL, too"},
        only={"nargs": "*", "help": "rows whose names begin with one of these"},
        frames={"type": int, "help": "of an orbit; default: 20, small 3"},
        patience={"type": float, "default": 45.0, "help": "seconds for a row of one program"},
        minutes={"type": float, "default": 7.0, "help": "after which no row begins"},
        orbit={"type": Path, "help": argparse.SUPPRESS},
    )
    asked.frames = asked.frames or (3 if asked.small else 20)
    return asked


def main() -> None:
    """Measure all rows, print and write the table."""
    asked, begin = parsed(), time.perf_counter()
    if asked.orbit:
        return orbit(asked.orbit, asked.frames, asked.device)
    card, has_vtk = driver_of(asked.device), _has("vtkmodules.vtkRenderingVolumeOpenGL2", asked.python)
    lines = [f"{card}; {'VTK beside it' if has_vtk else 'no VTK here'}; medians of {asked.frames} frames", ""]
    lines += [f"| {' | '.join(HEADER)} |", "|" + "---|" * len(HEADER)]
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
    tests = run_tests(60 * (asked.minutes + 1) - (time.perf_counter() - begin)) if asked.tests else None
    if tests:
        lines += ["", f"Tests marked gl and not mpi: {tests}"]
        print(*lines[-2:], sep="\n", flush=True)
    asked.folder.mkdir(parents=True, exist_ok=True)
    (asked.folder / "gpu.md").write_text("\n".join(lines) + "\n")
    report = {"card": card, "vtk": has_vtk, "frames": asked.frames, "rows": rows, "tests": tests}
    (asked.folder / "gpu.json").write_text(json.dumps(report, indent=1) + "\n")
    return None


if __name__ == "__main__":
    main()
