"""How far a picture is from the float64 reference: `python benchmarks/accuracy.py [DATA] [--filter F] [--json F]`.

One rank, the camera that a bare file gets, and three transfer functions: a smooth one (a Gaussian bump by many control
points), a narrow one (three peaks, each two grey levels wide) and one of steps. The reference samples the same slabs
in float64, so what is left are the errors of float32, of the filter, and of the shader's functions. Where the opacity
steps, a scalar within float32's last digits of a step may fall on its other side: one slab then differs by all of its
opacity, and the largest error tells little; the table says how many pixels are beyond 1e-5.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.data.samples import fetch_sample
from clusterviz.frame import render_frame
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.scene import Scene, Volume
from clusterviz.scene.values import ImageSettings, Quality

Points = tuple[tuple[float, float], ...]
TOLERANCE = 1e-5


def smooth(low: float, high: float) -> Points:
    """A bump of opacity over the upper half of the range, by 64 points."""
    place = np.linspace(0, 1, 64)
    opacity = 0.4 * np.exp(-(((place - 0.65) / 0.15) ** 2))
    return tuple(zip((low + place * (high - low)).tolist(), opacity.tolist(), strict=True))


def peaks(low: float, high: float) -> Points:
    """Three peaks, nothing between them, each 1 % of the range wide."""
    rows = [(low, 0.0)]
    for place, opacity in ((0.35, 0.3), (0.55, 0.6), (0.8, 0.9)):
        rows += [
            (low + (place + part) * (high - low), value)
            for part, value in ((-0.005, 0.0), (0.0, opacity), (0.005, 0.0))
        ]
    return (*rows, (high, 0.0))


def steps(low: float, high: float) -> Points:
    """Opacity that jumps at three values."""
    rows = [(low, 0.0)]
    before = 0.0
    for place, opacity in ((0.35, 0.02), (0.55, 0.2), (0.8, 0.7)):
        value = low + place * (high - low)
        rows += [(value, before), (value, opacity)]
        before = opacity
    return (*rows, (high, before))


FUNCTIONS = {"smooth": smooth, "narrow": peaks, "steps": steps}


def measure(path: str, function: str, step: float, filter: str, size: tuple[int, int]) -> dict[str, Any]:
    """Both pictures at one step, and their difference."""
    source = open_source(path, None)
    voxels = source.read((0, 0, 0), source.grid.shape_zyx)
    low, high = float(voxels.min()), float(voxels.max())
    volume = Volume(path=path, cmap="viridis", clim=(low, high), opacity=FUNCTIONS[function](low, high))
    scene = Scene(volumes=(volume,), image=ImageSettings(size=size), quality=Quality(step=step, filter=filter))
    rendered = render_frame(scene, LoopbackChannel(), source)
    started = perf_counter()
    expected = render_reference(rendered.scene, source.grid, voxels)
    seconds = perf_counter() - started
    difference = compare(rendered.image, expected, TOLERANCE)  # type: ignore[arg-type]
    found = {"function": function, "step_voxels": step, "filter": filter, "reference_seconds": seconds}
    return found | asdict(difference) | {"opacity_mean": float(expected[..., 3].mean())}


def main() -> None:
    """Print the table, and write it as JSON on request."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="?", help="a data file; default: the sample mni152")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--steps", type=float, nargs="+", default=[2.0, 1.0, 0.25])
    parser.add_argument("--filter", choices=["exact", "hardware"], default="exact")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    path = options.data or str(fetch_sample("mni152"))
    rows = []
    print(f"{path}, {options.size} × {options.size}, filter {options.filter}")
    print(f"{'function':9} {'step':>5} {'max':>9} {'rms':>9} {'pixels > 1e-5':>14} {'reference':>10}")
    for function in FUNCTIONS:
        for step in options.steps:
            row = measure(path, function, step, options.filter, (options.size, options.size))
            rows.append(row)
            print(
                f"{function:9} {step:5g} {row['max']:9.2e} {row['rms']:9.2e} {row['count']:14} "
                f"{row['reference_seconds']:8.1f} s",
                flush=True,
            )
    if options.json:
        options.json.write_text(json.dumps({"data": path, "size": options.size, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
