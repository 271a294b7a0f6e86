"""Speed and error of flows, beside VTK and NumPy, and on several ranks.

    python benchmarks/flow_ratio.py --peer-python PYTHON_WITH_VTK [--parts trace,ranks,lic,…] [--rounds 3] [--json F]

trace: streamlines of the ABC flow on two grids, forward, of a stated length, by RK4 with the same steps and by RK45
with the same tolerance, on one core: points of lines a second of CPU time, by this program, vtkStreamTracer and a NumPy
program. Rounds of all three alternate, each in a process of its own; times are minima. Errors are the distances of the
lines' ends from those with an eighth of the step, RK4, of lines that stay inside.
ranks: the same lines with RK45 under mpirun, over seeds and over data: seconds, and bytes that are handed over.
lic, lic-slice, lic-ranks: line integral convolution; see `flow_lic.py`.
surface: surface LIC; see `flow_surface.py`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import flow_lic
import flow_surface
import numpy as np

from clusterviz.comm import open_channel
from clusterviz.content.flow.section import Trace
from clusterviz.data.vectors import VectorArray, open_vectors
from clusterviz.flow.tracing import trace

SIDES, SEEDS, STEP_VOXELS, LENGTH = (64, 128), 10_000, 0.5, 2.0
TOLERANCE = 1e-5
PEER = Path(__file__).with_name("flow_peer.py")
Rows = list[dict[str, Any]]


def problem(side: int) -> tuple[VectorArray, Any]:
    """Return the vectors, and the seeds."""
    field = open_vectors(f"field:abc:{side}")
    vectors = VectorArray(field.read((0, 0, 0), field.grid.shape_zyx), field.grid)
    return vectors, np.random.default_rng(1).uniform(-0.9, 0.9, (SEEDS, 3))


def settings(method: str, refined: int = 1) -> Trace:
    """Return what lines are traced by."""
    step = STEP_VOXELS / refined
    return Trace(
        integrator=method, step=step, tolerance=TOLERANCE, direction="forward", max_length=LENGTH, max_steps=100_000
    )


def own_lines(side: int, method: str, refined: int = 1) -> tuple[float, int, Any]:
    """Return CPU seconds on one core, points, and the ends of lines by seed."""
    vectors, seeds = problem(side)
    trace(vectors, seeds[:1], settings(method), close=0, threads=1)  # which loads the kernel
    began = time.process_time()
    lines = trace(vectors, seeds, settings(method, refined), close=0, threads=1).lines
    seconds = time.process_time() - began
    ends = np.full((SEEDS, 3), np.nan)
    ends[lines.line_attributes["seed"]] = lines.points[lines.offsets[1:] - 1]
    return seconds, len(lines.points), ends


def measure_trace(options: argparse.Namespace) -> Rows:
    """Compare programs on one core."""
    return [row for side in SIDES for row in compare(side, options)]


def compare(side: int, options: argparse.Namespace) -> Rows:
    """Compare programs on a grid of this many samples a side."""
    rows = []
    vectors, seeds = problem(side)
    spacing = vectors.grid.spacing[0]
    exact = own_lines(side, "rk4", 8)[2]
    stays = (np.abs(exact) < 1 - spacing).all(axis=1)
    for method in ("rk4", "rk45"):
        found: dict[str, list[tuple[float, int, float]]] = {}
        with tempfile.TemporaryDirectory() as folder:
            file, output = Path(folder) / "problem.npz", Path(folder) / "ends.npz"
            numbers: dict[str, Any] = {"step": STEP_VOXELS * spacing, "length": LENGTH, "tolerance": TOLERANCE}
            read = vectors.read((0, 0, 0), vectors.grid.shape_zyx)
            np.savez(file, vectors=read, spacing=spacing, seeds=seeds, method=method, **numbers)
            for turn in range(options.rounds):
                results = {"clusterviz": own_lines(side, method)}
                for program in ("vtk", *(["numpy"] if method == "rk4" and not turn else [])):
                    command = [options.peer_python, str(PEER), str(file), program, str(output)]
                    printed = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
                    with np.load(output) as ends:
                        results[program] = printed["cpu_seconds"], printed["points"], ends["ends"]
                for program, (seconds, points, ends) in results.items():
                    errors = np.linalg.norm(ends - exact, axis=1)[stays]
                    found.setdefault(program, []).append((seconds, points, float(np.nanmedian(errors))))
        for program, rounds in found.items():
            seconds, points, error = min(rounds)
            ratio = min(found["vtk"])[0] / min(found["vtk"])[1] / (seconds / points)
            rows.append(
                {
                    "part": "trace",
                    "side": side,
                    "method": method,
                    "program": program,
                    "points": points,
                    "cpu_seconds": seconds,
                    "million_points_per_second": points / seconds / 1e6,
                    "median_error": error,
                    "times_vtk": ratio,
                }
            )
            print(
                f"trace  {side:3}³ {method:5} {program:11} {points / seconds / 1e6:7.3f} million points a second "
                f"and core, median error {error:.1e}, {ratio:.2f} times VTK",
                flush=True,
            )
    return rows


def measure_ranks(options: argparse.Namespace) -> Rows:
    """Trace the same lines on several ranks."""
    rows: Rows = []
    for ranks in (1, 2, 4):
        command = ["mpirun", "-n", str(ranks), sys.executable, __file__, "--rank-job"]
        lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
        rows += (json.loads(line) for line in lines if line.startswith("{"))
    for row in rows:
        print(
            f"ranks  {row['ranks']} over {row['over']:5} {row['seconds']:.2f} s, CPU {row['cpu_seconds']:.2f} s, "
            f"{row['bytes_handed_over'] / 1e6:.2f} MB in {row['rounds']} rounds",
            flush=True,
        )
    return rows


def rank_job() -> None:
    """Print what one rank count needs, from rank 0."""
    channel = open_channel()
    vectors, seeds = problem(SIDES[-1])
    for over in ("seeds", "data"):
        channel.barrier()
        began, cpu = time.perf_counter(), time.process_time()
        traced = trace(vectors, seeds, settings("rk45"), channel=channel, over=over, threads=1)  # type: ignore[arg-type]
        used = 1e-6 * channel.allgather_numbers([int(1e6 * (time.process_time() - cpu))]).sum()
        if channel.rank == 0:
            row = {"part": "ranks", "ranks": channel.size, "over": over, "seconds": time.perf_counter() - began}
            row |= {"cpu_seconds": float(used), "steps": traced.steps, "rounds": traced.rounds}
            print(json.dumps(row | {"bytes_handed_over": traced.bytes_handed_over}))


PARTS: dict[str, Callable[[argparse.Namespace], Rows]] = {
    "trace": measure_trace,
    "ranks": measure_ranks,
    **flow_lic.PARTS,
    **flow_surface.PARTS,
}


def main() -> None:
    """Measure the parts that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer-python", default=os.environ.get("CLUSTERVIZ_PEER_PYTHON", sys.executable))
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rank-job", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.rank_job:
        rank_job()
        return
    rows = [row for name in options.parts.split(",") for row in PARTS[name](options)]
    print(f"load {os.getloadavg()[0]:.1f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
