"""`clusterviz bench over`: time of the over operator relative to a copy of the same bytes.

The copy is NumPy's (memcpy) on one core, as are all variants. Blending in place reads two
images and writes one; many layers are compared with as many copies. A variant runs on several sets of images in turn,
so that no set is still in a cache. All images are slices of one pool of random premultiplied pixels.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from clusterviz.cli.arguments import Frames, parse_size
from clusterviz.cli.bench.report import JsonOption, one_core, write_json
from clusterviz.composite.fragment import Patch
from clusterviz.composite.over.blend import over, put_before, put_behind
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.image.partial import Rect

CACHE_BYTES = 256 << 20  # of all sets together: more than any cache
NUMPY_FRAMES = 3  # repetitions of the NumPy variant, which is slow
MAX_POOL_BYTES = 1 << 30  # largest pool in the table; fewer layers are used if eight need more
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
    """Measure the over operator relative to a copy of the same bytes, for bytes and for floats."""
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
    """Measure blending of two images in place for bytes and floats; milliseconds."""
    results = {}
    for pixel in (np.uint8, np.float32):
        results[np.dtype(pixel).name] = _measure(two_image_variants(make_pool(pixel, size, 2, CACHE_BYTES)), frames)
    return {"size": list(size), "frames": frames, "results": results}


def measure_all(sizes: list[tuple[int, int]], frames: int) -> dict[str, Any]:
    """Measure all variants for all pixel formats and sizes; milliseconds."""
    results = []
    for size in sizes:
        for pixel in PIXELS:
            rows: Rows = {}
            for variants in (two_image_variants, other_variants, multi_layer_variants):
                rows |= _measure(
                    variants(_pool(pixel, size, 8 if variants is multi_layer_variants else 3)), frames, rows.get("copy")
                )
            results.append({"size": list(size), "pixel": np.dtype(pixel).name, "variants": rows})
    return {"sizes": [list(size) for size in sizes], "frames": frames, "cores": os.cpu_count(), "results": results}


def _pool(pixel: type, size: tuple[int, int], images: int) -> Pool:
    most = MAX_POOL_BYTES // (2 * size[0] * size[1] * 4 * np.dtype(pixel).itemsize)
    return make_pool(pixel, size, max(2, min(images, most)), CACHE_BYTES)


def _measure(variants: dict[str, Variant], frames: int, copy: dict[str, float] | None = None) -> Rows:
    """Return the times of each variant and their ratios to a copy, the first variant or one measured before."""
    rows: Rows = {}
    for name, variant in variants.items():
        seconds = _time(variant, min(frames, NUMPY_FRAMES) if variant.slow else frames)
        row = {"min_ms": 1e3 * min(seconds), "median_ms": 1e3 * median(seconds)}
        copy = copy or row
        row["ratio"] = row["min_ms"] / copy["min_ms"] / variant.copies
        row["median_ratio"] = row["median_ms"] / copy["median_ms"] / variant.copies
        rows[name] = row
    return rows


def _time(variant: Variant, frames: int) -> list[float]:
    seconds = []
    with one_core():
        for number in range(1 + frames):
            started = perf_counter()
            variant.call(number % variant.sets)
            seconds.append(perf_counter() - started)
    return seconds[1:]


def _table(report: dict[str, Any]) -> str:
    """Return a Markdown table of ratios to a copy (milliseconds): a row a variant and format, a column a size."""
    heads = [f"{width} × {height}" for width, height in report["sizes"]]
    lines = ["| pixel | variant | " + " | ".join(heads) + " |", "|---|---|" + "--:|" * len(heads)]
    for pixel in (np.dtype(pixel).name for pixel in PIXELS):
        columns = [entry["variants"] for entry in report["results"] if entry["pixel"] == pixel]
        for name in dict.fromkeys(name for column in columns for name in column):
            rows = [column.get(name) for column in columns]
            cells = [f"{row['ratio']:.2f} ({row['min_ms']:.3g} ms)" if row else "" for row in rows]
            lines.append(f"| {pixel} | {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


RUN_PIXELS = 64  # length of the runs of active and of blank pixels in the variants with runs
RANDOM_PIXELS = 1 << 18  # random pixels, which the pool repeats


@dataclass(frozen=True)
class Variant:
    """Variant of the over operator."""

    call: Callable[[int], object]  # blends set number k
    sets: int
    copies: float = 1.0  # number of images in a copy of the same bytes
    slow: bool = False  # whether to time a few repetitions only


@dataclass(frozen=True)
class Pool:
    """Sets of images of one size and type: float32, float16 or uint8 (sets, images, pixels, 4)."""

    images: NDArray[Any]
    size: tuple[int, int]

    @property
    def patch(self) -> Patch:
        """Patch that covers a whole image."""
        return Patch(self.size[0], 0, self.size[0] * self.size[1], Rect(0, 0, *self.size))


def make_pool(pixel: type, size: tuple[int, int], images: int, cache_bytes: int) -> Pool:
    """Return at least two sets of images, together larger than the caches."""
    count = size[0] * size[1]
    sets = max(2, -(-cache_bytes // (images * count * 4 * np.dtype(pixel).itemsize)))
    rng = np.random.default_rng(0)
    alpha = rng.random((RANDOM_PIXELS, 1), np.float32)
    tile = np.concatenate([rng.random((RANDOM_PIXELS, 3), np.float32) * alpha, alpha], axis=1)
    tile = np.rint(tile * 255).astype(np.uint8) if pixel is np.uint8 else tile.astype(pixel)
    return Pool(np.resize(tile, (sets, images, count, 4)), size)


def two_image_variants(pool: Pool) -> dict[str, Variant]:
    """Return variants for two images: a copy, in place from both sides, and NumPy."""
    front, target, patch, sets = pool.images[:, 0], pool.images[:, 1], pool.patch, len(pool.images)
    return {
        "copy": Variant(lambda k: np.copyto(target[k], front[k]), sets),
        "put_before": Variant(lambda k: put_before(target[k], patch, front[k], patch), sets),
        "put_behind": Variant(lambda k: put_behind(target[k], patch, front[k], patch), sets),
        "numpy": Variant(lambda k: over(front[k], target[k]), sets, slow=True),
    }


def other_variants(pool: Pool) -> dict[str, Variant]:
    """Return variants for rectangles, and for runs of active pixels."""
    front, back, out, patch = (*(pool.images[:, index] for index in range(3)), pool.patch)
    (width, height), sets = pool.size, len(pool.images)
    middle = Patch(width, 0, width * height, Rect(width // 4, 0, width // 4 + width // 2, height))
    active, runs = patch.count // (2 * RUN_PIXELS) * RUN_PIXELS, _every_second_run(patch.count)
    into_strip = [[Layer(patch, half[k][:active], runs) for half in (front, back)] for k in range(sets)]
    return {
        "rectangle into strip": Variant(
            lambda k: put_before(out[k], patch, front[k][: middle.count], middle), sets, middle.count / patch.count
        ),
        "runs into strip": Variant(lambda k: blend_layers(into_strip[k], patch, out[k]), sets),
    }


def _every_second_run(count: int) -> NDArray[np.int32]:
    first = np.arange(0, count // (2 * RUN_PIXELS) * 2 * RUN_PIXELS, 2 * RUN_PIXELS, dtype=np.int32)
    return np.stack([first, np.full_like(first, RUN_PIXELS)], axis=1)


def multi_layer_variants(pool: Pool) -> dict[str, Variant]:
    """Return variants for two, four and eight layers into one byte image."""
    patch, sets = pool.patch, len(pool.images)
    out = np.zeros((sets, patch.count, 4), np.uint8)

    def blend(count: int) -> Variant:
        layers = [[Layer(patch, image) for image in images[:count]] for images in pool.images]
        return Variant(lambda k: blend_layers(layers[k], patch, out[k]), sets, copies=count)

    return {f"{count} layers": blend(count) for count in (2, 4, 8) if count <= pool.images.shape[1]}
