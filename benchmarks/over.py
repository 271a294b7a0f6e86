"""How fast the over operator is, against a copy of the same bytes: `python benchmarks/over.py [--json F]`.

One thread, 1920 × 1600 pixels. The copy is NumPy's (the C library's memcpy); blending in place reads both images and
writes one. Several sets of images take turns, so that none waits in a cache for its next turn.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from clusterviz.composite.blend import over, put_before, put_behind
from clusterviz.composite.patch import Patch
from clusterviz.image.region import Rect

CACHE_BYTES = 256 << 20  # all sets together: more than any cache holds


def candidates(dtype: type, size: tuple[int, int], sets: int) -> dict[str, Callable[[int], object]]:
    """The copy, the kernels, and the plain twin, on one of several sets of premultiplied random pixels."""
    rng = np.random.default_rng(0)
    count = size[0] * size[1]
    alpha = rng.random((2 * sets, count, 1), np.float32)
    images = np.concatenate([rng.random((2 * sets, count, 3), np.float32) * alpha, alpha], axis=2)
    if dtype is np.uint8:
        images = np.rint(images * 255).astype(np.uint8)
    patch = Patch(size[0], 0, count, Rect(0, 0, *size))
    front, target = images[:sets], images[sets:]
    return {
        "copy": lambda k: np.copyto(target[k], front[k]),
        "put_before": lambda k: put_before(target[k], patch, front[k], patch),
        "put_behind": lambda k: put_behind(target[k], patch, front[k], patch),
        "numpy": lambda k: over(front[k], target[k]),
    }


def measure(dtype: type, size: tuple[int, int], rounds: int) -> dict[str, dict[str, float]]:
    """Milliseconds of each candidate, and how they compare with the copy's."""
    sets = max(2, CACHE_BYTES // (8 * size[0] * size[1] * np.dtype(dtype).itemsize))
    calls = candidates(dtype, size, sets)
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for name, call in calls.items():
        for number in range(1 + (rounds if name != "numpy" else 3)):
            started = perf_counter()
            call(number % sets)
            if number:
                seconds[name].append(perf_counter() - started)
    least, middle = min(seconds["copy"]), statistics.median(seconds["copy"])
    return {
        name: {
            "min_ms": 1e3 * min(s),
            "median_ms": 1e3 * statistics.median(s),
            "ratio": min(s) / least,
            "median_ratio": statistics.median(s) / middle,
        }
        for name, s in seconds.items()
    }


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=1920)
    parser.add_argument("--height", type=int, default=1600)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    # One core: the copy and the kernels are single-threaded, but the scheduler shall not move them either.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    size = (options.width, options.height)
    results = {np.dtype(dtype).name: measure(dtype, size, options.rounds) for dtype in (np.uint8, np.float32)}
    for dtype, rows in results.items():
        for name, row in rows.items():
            milliseconds = f"min {row['min_ms']:7.2f} ms, median {row['median_ms']:7.2f} ms"
            print(f"{dtype:8} {name:11} {milliseconds}, copy x {row['ratio']:.2f} (medians {row['median_ratio']:.2f})")
    if options.json:
        report = {"size": size, "rounds": options.rounds, "results": results}
        options.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
