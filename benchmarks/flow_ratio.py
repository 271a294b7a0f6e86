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
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import flow_lic
import flow_surface
import numpy as np
from measuring import PEER_PYTHON, Row, answer_of, answers_of, beside, commas, options, show, timed, write

from clusterviz.comm import open_channel
from clusterviz.content.flow.section import Trace
from clusterviz.data.vectors import VectorArray, open_vectors
from clusterviz.flow.tracing import trace

SIDES, SEEDS, STEP_VOXELS, LENGTH = (64, 128), 10_000, 0.5, 2.0
TOLERANCE = 1e-5
Traced = tuple[float, int, Any]
"""CPU seconds, points of lines, and their ends by seed."""


def problem(side: int) -> tuple[VectorArray, Any]:
    """Return the vectors, and the seeds."""
    field = open_vectors(f"field:abc:{side}")
    vectors = VectorArray(field.read((0, 0, 0), field.grid.shape_zyx), field.grid)
    return vectors, np.random.default_rng(1).uniform(-0.9, 0.9, (SEEDS, 3))


def settings(method: str, refined: int = 1) -> Trace:
    """Return what lines are traced by."""
    how: dict[str, Any] = {"integrator": method, "step": STEP_VOXELS / refined, "tolerance": TOLERANCE}
    return Trace(**how, direction="forward", max_length=LENGTH, max_steps=100_000)


def own_lines(side: int, method: str, refined: int = 1) -> Traced:
    """Trace on one core."""
    vectors, seeds = problem(side)
    trace(vectors, seeds[:1], settings(method), close=0, threads=1)  # which loads the kernel
    run = timed(lambda: trace(vectors, seeds, settings(method, refined), close=0, threads=1).lines)
    lines, ends = run.value, np.full((SEEDS, 3), np.nan)
    ends[lines.line_attributes["seed"]] = lines.points[lines.offsets[1:] - 1]
    return run.cpu, len(lines.points), ends


def compare(side: int, method: str, asked: argparse.Namespace) -> Iterator[Row]:
    """Compare programs on a grid of this many samples a side."""
    vectors, seeds = problem(side)
    spacing, exact = vectors.grid.spacing[0], own_lines(side, "rk4", 8)[2]
    stays = (np.abs(exact) < 1 - spacing).all(axis=1)
    found: dict[str, list[Traced]] = {}
    with tempfile.TemporaryDirectory() as folder:
        file, output = Path(folder) / "problem.npz", Path(folder) / "ends.npz"
        numbers: dict[str, Any] = {"step": STEP_VOXELS * spacing, "length": LENGTH, "tolerance": TOLERANCE}
        read = vectors.read((0, 0, 0), vectors.grid.shape_zyx)
        np.savez(file, vectors=read, spacing=spacing, seeds=seeds, method=method, **numbers)
        for turn in range(asked.rounds):
            found.setdefault("clusterviz", []).append(own_lines(side, method))
            for program in ("vtk", *(["numpy"] if method == "rk4" and not turn else [])):
                told = answer_of([asked.peer_python, beside("flow_peer.py"), program, file, output])
                with np.load(output) as ends:
                    found.setdefault(program, []).append((told["cpu_seconds"], told["points"], ends["ends"]))
    theirs = min(found["vtk"], key=lambda each: each[0])
    for program, rounds in found.items():
        seconds, points, ends = min(rounds, key=lambda each: each[0])
        row: Row = {"side": side, "method": method, "program": program, "rate": points / seconds}
        row["error"] = float(np.nanmedian(np.linalg.norm(ends - exact, axis=1)[stays]))
        yield row | {"times_vtk": theirs[0] / theirs[1] / (seconds / points)}


def measure_trace(asked: argparse.Namespace) -> list[Row]:
    """Compare programs on one core."""
    rows = (row for pair in product(SIDES, ("rk4", "rk45")) for row in compare(*pair, asked))
    head = "side | method | program | million points a second and core | median error | times VTK"
    cells = "{side} | {method} | {program} | {rate!M:.3f} | {error:.1e} | {times_vtk:.2f}"
    return show(head, cells, rows, "trace")


def measure_ranks(asked: argparse.Namespace) -> list[Row]:
    """Trace the same lines on several ranks."""
    command = [sys.executable, __file__, "--rank-job"]
    rows = (row for ranks in (1, 2, 4) for row in answers_of(["mpirun", "-n", ranks, *command]))
    head = "ranks | over | s | CPU s | MB handed over | rounds"
    cells = "{ranks} | {over} | {seconds:.2f} | {cpu_seconds:.2f} | {bytes_handed_over!M:.2f} | {rounds}"
    return show(head, cells, rows, "ranks")


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
            row = {"ranks": channel.size, "over": over, "seconds": time.perf_counter() - began}
            row |= {"cpu_seconds": float(used), "steps": traced.steps, "rounds": traced.rounds}
            print(json.dumps(row | {"bytes_handed_over": traced.bytes_handed_over}))


PARTS: dict[str, Callable[[argparse.Namespace], list[Row]]] = {
    "trace": measure_trace,
    "ranks": measure_ranks,
    **flow_lic.PARTS,
    **flow_surface.PARTS,
}


def main() -> None:
    """Measure the parts that are named."""
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
