"""From mpirun to the first picture, and where the time goes: `python benchmarks/first_pixel.py [--ranks 4] [--json F]`.

Renders a 200³ field, and splits the wall-clock time by what the statistics of the slowest rank say. The remainder is
mpirun's own start and end, and the ends of the processes.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from pathlib import Path
from time import perf_counter

from clusterviz.cli.jobs import run_job

PARTS = {
    "interpreter": ("start.interpreter",),
    "imports": ("start.imports",),
    "MPI": ("start.mpi",),
    "context": ("context",),
    "shaders": ("shaders",),
    "reading": ("load",),
    "planning": ("plan",),
    "rendering": ("render", "readback"),
    "kernels": ("kernels",),
    "compositing": ("encode", "exchange", "blend", "collect"),
    "writing": ("finish",),
}


def measure(scene: str, ranks: int, size: str) -> dict[str, float]:
    """Seconds of one run: by part, and of the whole."""
    with tempfile.TemporaryDirectory() as folder:
        picture, stats = Path(folder) / "picture.png", Path(folder) / "statistics.json"
        started = perf_counter()
        run_job(ranks, ["render", scene, "-o", str(picture), "--stats", str(stats), "--size", size])
        whole = perf_counter() - started
        report = json.loads(stats.read_text())
    seconds = {f"start.{name}": value for name, value in report["startup"].items()} | report["frames"][0]["seconds"]
    parts = {part: sum(seconds.get(name, 0.0) for name in names) for part, names in PARTS.items()}
    waiting = seconds["total"] - sum(
        value for name, value in parts.items() if name not in ("interpreter", "imports", "MPI")
    )
    before = sum(report["startup"].values())
    return {
        **parts,
        "waiting for each other": max(0.0, waiting),
        "mpirun and the ends": whole - before - seconds["total"],
        "whole": whole,
    }


def main() -> None:
    """Print the medians as a table, and write every run as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="field:marschner-lobb:200")
    parser.add_argument("--ranks", type=int, default=4)
    parser.add_argument("--size", default="512x512")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    measure(options.scene, options.ranks, options.size)  # fills the caches of the system and of numba
    runs = [measure(options.scene, options.ranks, options.size) for _ in range(options.runs)]
    print(f"{options.scene}, {options.ranks} ranks, {options.size}: medians of {options.runs} runs, slowest rank")
    for part in runs[0]:
        print(f"{part:24} {statistics.median(run[part] for run in runs):7.3f} s")
    if options.json:
        chosen = {"scene": options.scene, "ranks": options.ranks, "size": options.size}
        options.json.write_text(json.dumps({**chosen, "runs": runs}, indent=2) + "\n")


if __name__ == "__main__":
    main()
