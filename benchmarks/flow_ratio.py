"""Speed and error of flows, beside VTK and NumPy, and on several ranks.

    python benchmarks/flow_ratio.py --peer-python PYTHON_WITH_VTK [--parts trace,ranks,lic,surface] [--json F]

trace: streamlines of the ABC flow on two grids, forward, of a stated length, by RK4 with the same steps and by RK45
with the same tolerance, on one core: points of lines a second of CPU time, by this program, vtkStreamTracer and a NumPy
program. Rounds of all three alternate; times are minima. Errors are the distances of the lines' ends from those with an
eighth of the step, RK4, of lines that stay inside.
ranks: the same lines with RK45 under mpirun, over seeds and over data: seconds, and bytes that are handed over.
lic: samples of lines a second of CPU time and core, noise and reading included: a grid of 256³ with the default
settings on all cores; a slice of 512² with white noise and a box kernel by this program and by vtkImageDataLIC2D, which
draws by OpenGL, without a GPU on the CPU too. VTK always convolves a second time, with half the steps: they count.
surface: CPU seconds that the pattern adds to a frame of 800² of a sphere. Lines have 40 steps of half a pixel each way,
RK4 here and RK2 in VTK's mapper. Frames turn the camera; medians without the first one.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from measuring import PEER_PYTHON, Row, answer_of, answers_of, beside, commas, middle, options, show, timed, write
from vtk_mappers_ratio import sphere

from clusterviz.comm import LoopbackChannel, open_channel
from clusterviz.content.flow.section import Lic, Trace
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.data.vectors import VectorArray, open_vectors
from clusterviz.flow.lic import LicSource, noise_of, steps_of
from clusterviz.flow.tracing import trace
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene import Scene

SIDES, SEEDS, STEP_VOXELS, LENGTH = (64, 128), 10_000, 0.5, 2.0
TOLERANCE = 1e-5
VOLUME_SIDE, SLICE_SIDE, ORIGIN = 256, 512, (0, 0, 0)
PICTURE, LIC_STEPS, STEP_PIXELS, RINGS = 800, 40, 0.5, 48
PLACES = np.random.default_rng(1).uniform(-0.9, 0.9, (SEEDS, 3))
EYES = [(-3.9 + 0.05 * n, -2.9, 1.9) for n in range(4)]
Traced = tuple[float, int, Any]
"""CPU seconds, points of lines, and their ends by seed."""


def abc(side: int) -> VectorArray:
    field = open_vectors(f"field:abc:{side}")
    return VectorArray(field.read(ORIGIN, field.grid.shape_zyx), field.grid)


def vtk(asked: argparse.Namespace, program: str, output: str | Path = "-", **given: Any) -> Row:
    """Solve a problem by flow_peer.py."""
    with tempfile.TemporaryDirectory() as folder:
        np.savez(file := Path(folder) / "problem.npz", **given)
        return answer_of([asked.peer_python, beside("flow_peer.py"), program, file, output])


def settings(method: str, refined: int = 1) -> Trace:
    how: dict[str, Any] = {"integrator": method, "step": STEP_VOXELS / refined, "tolerance": TOLERANCE}
    return Trace(**how, direction="forward", max_length=LENGTH, max_steps=100_000)


def own_lines(vectors: VectorArray, method: str, refined: int = 1) -> Traced:
    """Trace on one core."""
    trace(vectors, PLACES[:1], settings(method), close=0, threads=1)  # which loads the kernel
    run = timed(lambda: trace(vectors, PLACES, settings(method, refined), close=0, threads=1).lines)
    lines, ends = run.value, np.full((SEEDS, 3), np.nan)
    ends[lines.line_attributes["seed"]] = lines.points[lines.offsets[1:] - 1]
    return run.cpu, len(lines.points), ends


def compared(side: int, method: str, asked: argparse.Namespace) -> Iterator[Row]:
    """Programs on a grid of this many samples a side."""
    vectors = abc(side)
    spacing, exact = vectors.grid.spacing[0], own_lines(vectors, "rk4", 8)[2]
    stays = (np.abs(exact) < 1 - spacing).all(axis=1)
    found: dict[str, list[Traced]] = {}
    given: dict[str, Any] = {"step": STEP_VOXELS * spacing, "length": LENGTH, "tolerance": TOLERANCE}
    given |= {"vectors": vectors.read(ORIGIN, vectors.grid.shape_zyx), "spacing": spacing, "seeds": PLACES}
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "ends.npz"
        for turn in range(asked.rounds):
            found.setdefault("clusterviz", []).append(own_lines(vectors, method))
            for program in ("vtk", *(["numpy"] if method == "rk4" and not turn else [])):
                told = vtk(asked, program, output, method=method, **given)
                with np.load(output) as ends:
                    found.setdefault(program, []).append((told["cpu_seconds"], told["points"], ends["ends"]))
    theirs = min(found["vtk"], key=lambda each: each[0])
    for program, rounds in found.items():
        seconds, points, ends = min(rounds, key=lambda each: each[0])
        row: Row = {"side": side, "method": method, "program": program, "rate": points / seconds}
        row["error"] = float(np.nanmedian(np.linalg.norm(ends - exact, axis=1)[stays]))
        yield row | {"times_vtk": theirs[0] / theirs[1] / (seconds / points)}


def measure_trace(asked: argparse.Namespace) -> list[Row]:
    rows = (row for pair in product(SIDES, ("rk4", "rk45")) for row in compared(*pair, asked))
    head = "side | method | program | million points a second and core | median error | times VTK"
    cells = "{side} | {method} | {program} | {rate!M:.3f} | {error:.1e} | {times_vtk:.2f}"
    return show(head, cells, rows, "trace")


def measure_ranks(asked: argparse.Namespace) -> list[Row]:
    command = [sys.executable, __file__, "--rank-job"]
    rows = (row for ranks in (1, 2, 4) for row in answers_of(["mpirun", "-n", ranks, *command]))
    head = "ranks | over | s | CPU s | MB handed over | rounds"
    cells = "{ranks} | {over} | {seconds:.2f} | {cpu_seconds:.2f} | {bytes_handed_over!M:.2f} | {rounds}"
    return show(head, cells, rows, "ranks")


def rank_job() -> None:
    """Print what one rank count needs, from rank 0."""
    channel, vectors = open_channel(), abc(SIDES[-1])
    trace(vectors, PLACES[:1], settings("rk45"), channel=channel, threads=1)  # which loads the kernel
    for over in ("seeds", "data"):
        channel.barrier()
        how: dict[str, Any] = {"channel": channel, "over": over, "threads": 1}
        run = timed(lambda how=how: trace(vectors, PLACES, settings("rk45"), **how))
        used = 1e-6 * channel.allgather_numbers([int(1e6 * run.cpu)]).sum()
        if channel.rank == 0:
            row = {"ranks": channel.size, "over": over, "seconds": run.wall, "cpu_seconds": float(used)}
            row |= {"steps": run.value.steps, "rounds": run.value.rounds}
            print(json.dumps(row | {"bytes_handed_over": run.value.bytes_handed_over}))


def convolved(asked: argparse.Namespace) -> Iterator[Row]:
    """The volume, and the slice by both programs."""

    def row(what: str, program: str, samples: float, cpu: float) -> Row:
        return {"what": what, "program": program, "cpu_seconds": cpu, "speed": samples / cpu}

    lic, vectors = Lic(contrast=False), abc(VOLUME_SIDE)
    LicSource(vectors, lic).read(ORIGIN, (8, 8, 8))  # which loads the kernel
    run = timed(lambda: LicSource(vectors, lic).read(ORIGIN, (VOLUME_SIDE,) * 3))
    yield row(f"{VOLUME_SIDE}³", "clusterviz", (2 * steps_of(lic) + 1) * VOLUME_SIDE**3, run.cpu)

    lic, shape = Lic(noise="white", kernel="box", contrast=False), (1, SLICE_SIDE, SLICE_SIDE)
    steps, along = steps_of(lic), np.arange(SLICE_SIDE) * (2 * np.pi / SLICE_SIDE)
    values = np.zeros((*shape, 3), np.float32)
    values[0, :, :, 0] = np.sin(along)[:, None] + 0.5 * np.cos(3 * along)
    values[0, :, :, 1] = np.cos(2 * along)
    plane, noise = VectorArray(values), noise_of(lic).read(shape, ORIGIN, shape)
    LicSource(plane, lic).read(ORIGIN, (1, 8, 8))
    least = min(timed(lambda: LicSource(plane, lic).read(ORIGIN, shape)).cpu for _ in range(asked.rounds))
    given = {"vectors": values[0], "noise": noise[0], "steps": steps, "step": lic.step, "rounds": asked.rounds}
    theirs, samples = vtk(asked, "lic", **given)["cpu_seconds"], (2 * steps + 1) * SLICE_SIDE**2
    yield row(f"slice of {SLICE_SIDE}²", "clusterviz", samples, least)
    yield row(f"slice of {SLICE_SIDE}²", "vtk", samples * 3 // 2, theirs)


def measure_lic(asked: argparse.Namespace) -> list[Row]:
    head, cells = "what | program | CPU s | million samples a second and core", "{what} | {program} | "
    return show(head, cells + "{cpu_seconds:.2f} | {speed!M:.2f}", convolved(asked), "lic")


def own_surface() -> list[float]:
    vertices, faces = sphere(0.8, RINGS)
    mesh = Geometry(mesh=Mesh("sphere", vertices, faces))
    lic, found = {"length": 2 * LIC_STEPS * STEP_PIXELS, "step": STEP_PIXELS}, []
    for flows in ([{"path": "field:abc:64", "show": "surface-lic", "lic": lic, "color_by": "color"}], []):
        keys: dict[str, Any] = {
            "volumes": [{"path": "field:constant:64", "opacity": 0.0, "clim": [0, 1]}],
            "meshes": [{"path": "sphere"}],
            "flows": flows,
            "camera": {"position": EYES[0], "focal_point": (0, 0, 0), "view_up": (0, 0, 1), "view_angle": 22},
            "image": {"size": [PICTURE, PICTURE]},
        }
        given: list[Any] = [None, mesh, *[None] * len(flows)]
        with FrameLoop(Scene.model_validate(keys), LoopbackChannel(), given, Options("cpu")) as loop:
            cameras = [loop.scene.camera.model_copy(update={"position": eye}) for eye in EYES]
            scenes = [loop.scene.model_copy(update={"camera": camera}) for camera in cameras]
            runs = [timed(lambda loop=loop, scene=scene: loop.frame(scene)) for scene in scenes]
        found.append(middle(runs[1:], "cpu"))
    return found


def measure_surface(asked: argparse.Namespace) -> list[Row]:
    given = {"size": PICTURE, "steps": LIC_STEPS, "step": STEP_PIXELS, "around": 2 * RINGS, "eyes": np.array(EYES)}
    found = {"clusterviz": own_surface(), "vtk": vtk(asked, "surface", **given)["cpu_seconds"]}
    rows: list[Row] = [
        {"program": program, "cpu_seconds": painted - plain, "plain": plain}
        for program, (painted, plain) in found.items()
    ]
    head, cells = "program | CPU s for the pattern | CPU s without", "{program} | {cpu_seconds:.2f} | {plain:.2f}"
    return show(head, cells, rows, "surface")


PARTS: dict[str, Callable[[argparse.Namespace], list[Row]]] = {
    "trace": measure_trace,
    "ranks": measure_ranks,
    "lic": measure_lic,
    "surface": measure_surface,
}


def main() -> None:
    parts = {"type": commas(str), "default": list(PARTS)}
    hidden = {"action": "store_true", "help": argparse.SUPPRESS}
    asked = options(__doc__, peer_python=PEER_PYTHON, parts=parts, rounds=3, rank_job=hidden)
    if asked.rank_job:
        rank_job()
        return
    found = {name: PARTS[name](asked) for name in asked.parts}
    print(f"\nload {os.getloadavg()[0]:.1f}")
    write(asked, **found)


if __name__ == "__main__":
    main()
