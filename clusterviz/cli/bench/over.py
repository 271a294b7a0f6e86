"""`clusterviz bench over`: how fast the over operator is, against a copy of the same bytes.

The copy is NumPy's (the C library's memcpy), on one core, as is all that does not say otherwise; blending in place
reads both images and writes one. Many layers are measured against as many copies. Several sets of images take turns, so
that none waits in a cache for its next turn.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer

from clusterviz.cli.arguments import parse_size
from clusterviz.cli.bench.over_variants import Pool, Variant, make_pool, many, pairs, shapes
from clusterviz.cli.bench.report import Frames, JsonOption, write_json

CACHE_BYTES = 256 << 20  # all sets together: more than any cache holds
PLAIN_FRAMES = 3  # of the NumPy twin, which is slow
LARGEST = 1 << 30  # bytes of one pool of images in the table: fewer layers where eight would take more
PIXELS = (np.uint8, np.float16, np.float32)
SIZES = "256x256,512x512,1024x1024,1920x1600,2048x2048,4096x4096"

Rows = dict[str, dict[str, float]]


def command(
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the images.")] = "1920x1600",
    sizes: Annotated[
        str | None, typer.Option(metavar="WxH,…", help=f"A table of all variants instead: {SIZES}, for example.")
    ] = None,
    frames: Frames = 40,
    json: JsonOption = None,
) -> None:
    """Measure the over operator beside a copy of the same bytes, for bytes and for floats."""
    if sizes is not None:
        report = measure_all([parse_size(text) for text in sizes.split(",")], frames)
        print(_table(report))
    else:
        report = measure(parse_size(size), frames)
        for pixel, rows in report["results"].items():
            for name, row in rows.items():
                times = f"min {row['min_ms']:7.2f} ms, median {row['median_ms']:7.2f} ms"
                print(f"{pixel:8} {name:11} {times}, copy x {row['ratio']:.2f} (medians {row['median_ratio']:.2f})")
    if json:
        write_json(json, report)


def measure(size: tuple[int, int], frames: int) -> dict[str, Any]:
    """Milliseconds of two images in place for bytes and floats, on one core, where the system can be told so."""
    results = {}
    for pixel in (np.uint8, np.float32):
        results[np.dtype(pixel).name] = _measure(pairs(make_pool(pixel, size, 2, CACHE_BYTES)), frames)
    return {"size": list(size), "frames": frames, "results": results}


def measure_all(sizes: list[tuple[int, int]], frames: int) -> dict[str, Any]:
    """Milliseconds of every variant for every type and size."""
    results = []
    for size in sizes:
        for pixel in PIXELS:
            rows: Rows = {}
            for variants in (pairs, shapes, many):
                rows |= _measure(variants(_pool(pixel, size, 8 if variants is many else 3)), frames, rows.get("copy"))
            results.append({"size": list(size), "pixel": np.dtype(pixel).name, "variants": rows})
    return {"sizes": [list(size) for size in sizes], "frames": frames, "cores": os.cpu_count(), "results": results}


def _pool(pixel: type, size: tuple[int, int], images: int) -> Pool:
    most = LARGEST // (2 * size[0] * size[1] * 4 * np.dtype(pixel).itemsize)
    return make_pool(pixel, size, max(2, min(images, most)), CACHE_BYTES)


def _measure(variants: dict[str, Variant], frames: int, copy: dict[str, float] | None = None) -> Rows:
    """The times of each variant, and how they compare with the copy: one of theirs, or one measured before."""
    rows: Rows = {}
    for name, variant in variants.items():
        seconds = _time(variant, min(frames, PLAIN_FRAMES) if variant.slow else frames)
        row = {"min_ms": 1e3 * min(seconds), "median_ms": 1e3 * median(seconds)}
        copy = copy or row
        row["ratio"] = row["min_ms"] / copy["min_ms"] / variant.copies
        row["median_ratio"] = row["median_ms"] / copy["median_ms"] / variant.copies
        rows[name] = row
    return rows


def _time(variant: Variant, frames: int) -> list[float]:
    """Seconds of each call, after one that is not timed."""
    seconds = []
    with _one_core(not variant.threaded):
        for number in range(1 + frames):
            started = perf_counter()
            variant.call(number % variant.sets)
            seconds.append(perf_counter() - started)
    return seconds[1:]


@contextmanager
def _one_core(wanted: bool) -> Iterator[None]:
    """Keep this thread on one core, so that the scheduler does not move it either."""
    allowed = os.sched_getaffinity(0) if wanted and hasattr(os, "sched_getaffinity") else set()
    if allowed:
        os.sched_setaffinity(0, {min(allowed)})
    try:
        yield
    finally:
        if allowed:
            os.sched_setaffinity(0, allowed)


def _table(report: dict[str, Any]) -> str:
    """Markdown: a line for each variant and type, a column for each size, each cell ratio to a copy (milliseconds)."""
    heads = [f"{width} × {height}" for width, height in report["sizes"]]
    lines = ["| pixel | variant | " + " | ".join(heads) + " |", "|---|---|" + "--:|" * len(heads)]
    for pixel in (np.dtype(pixel).name for pixel in PIXELS):
        columns = [entry["variants"] for entry in report["results"] if entry["pixel"] == pixel]
        for name in dict.fromkeys(name for column in columns for name in column):
            cells = [_cell(column.get(name)) for column in columns]
            lines.append(f"| {pixel} | {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(row: dict[str, float] | None) -> str:
    return f"{row['ratio']:.2f} ({row['min_ms']:.3g} ms)" if row else ""
