"""`clusterviz bench over`: how fast the over operator is, against a copy of the same bytes.

One thread. The copy is NumPy's (the C library's memcpy); blending in place reads both images and writes one. Several
sets of images take turns, so that none waits in a cache for its next turn.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer

from clusterviz.cli.arguments import parse_size
from clusterviz.cli.bench.report import Frames, JsonOption, write_json
from clusterviz.composite.blend import over, put_before, put_behind
from clusterviz.composite.patch import Patch
from clusterviz.image.region import Rect

CACHE_BYTES = 256 << 20  # all sets together: more than any cache holds
PLAIN_FRAMES = 3  # of the NumPy twin, which is slow


def command(
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the images.")] = "1920x1600",
    frames: Frames = 40,
    json: JsonOption = None,
) -> None:
    """Measure the over operator beside a copy of the same bytes, for bytes and for floats."""
    report = measure(parse_size(size), frames)
    if json:
        write_json(json, report)
    for pixel, rows in report["results"].items():
        for name, row in rows.items():
            milliseconds = f"min {row['min_ms']:7.2f} ms, median {row['median_ms']:7.2f} ms"
            print(f"{pixel:8} {name:11} {milliseconds}, copy x {row['ratio']:.2f} (medians {row['median_ratio']:.2f})")


def measure(size: tuple[int, int], frames: int) -> dict[str, Any]:
    """Milliseconds of each candidate for both types of pixel; on one core, where the system can be told so."""
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
    if allowed:
        # All candidates have one thread, but the scheduler shall not move it either.
        os.sched_setaffinity(0, {min(allowed)})
    try:
        results = {np.dtype(pixel).name: _measure(pixel, size, frames) for pixel in (np.uint8, np.float32)}
    finally:
        if allowed:
            os.sched_setaffinity(0, allowed)
    return {"size": list(size), "frames": frames, "results": results}


def _candidates(pixel: type, size: tuple[int, int], sets: int) -> dict[str, Callable[[int], object]]:
    """The copy, the kernels, and the plain twin, on one of several sets of premultiplied random pixels."""
    rng = np.random.default_rng(0)
    count = size[0] * size[1]
    alpha = rng.random((2 * sets, count, 1), np.float32)
    images = np.concatenate([rng.random((2 * sets, count, 3), np.float32) * alpha, alpha], axis=2)
    if pixel is np.uint8:
        images = np.rint(images * 255).astype(np.uint8)
    patch = Patch(size[0], 0, count, Rect(0, 0, *size))
    front, target = images[:sets], images[sets:]
    return {
        "copy": lambda k: np.copyto(target[k], front[k]),
        "put_before": lambda k: put_before(target[k], patch, front[k], patch),
        "put_behind": lambda k: put_behind(target[k], patch, front[k], patch),
        "numpy": lambda k: over(front[k], target[k]),
    }


def _measure(pixel: type, size: tuple[int, int], frames: int) -> dict[str, dict[str, float]]:
    sets = max(2, CACHE_BYTES // (8 * size[0] * size[1] * np.dtype(pixel).itemsize))
    calls = _candidates(pixel, size, sets)
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for name, call in calls.items():
        for number in range(1 + (frames if name != "numpy" else min(frames, PLAIN_FRAMES))):
            started = perf_counter()
            call(number % sets)
            if number:
                seconds[name].append(perf_counter() - started)
    least, middle = min(seconds["copy"]), median(seconds["copy"])
    return {
        name: {
            "min_ms": 1e3 * min(s),
            "median_ms": 1e3 * median(s),
            "ratio": min(s) / least,
            "median_ratio": median(s) / middle,
        }
        for name, s in seconds.items()
    }
