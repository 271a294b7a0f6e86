"""How far a picture is from the float64 reference: `python benchmarks/accuracy.py [DATA] [--filter F] [--json F]`.

One rank, the camera that a bare file gets, and three transfer functions: a smooth one (a Gaussian bump by many control
points), a narrow one (three peaks, each two grey levels wide) and one of steps. The reference samples the same slabs
in float64, so what is left are the errors of float32, of the filter, and of the shader's functions. Where the opacity
steps, a scalar within float32's last digits of a step may fall on its other side: one slab then differs by all of its
opacity, and the largest error tells little; the table says how many pixels are beyond 1e-5.
"""

from __future__ import annotations

from dataclasses import asdict
from itertools import product
from typing import Any

import numpy as np
from measuring import Row, opened, options, positional, sample, show, timed, write

from clusterviz.comm import LoopbackChannel
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
        for part, value in ((-0.005, 0.0), (0.0, opacity), (0.005, 0.0)):
            rows.append((low + (place + part) * (high - low), value))
    return (*rows, (high, 0.0))


def steps(low: float, high: float) -> Points:
    """Opacity that jumps at three values."""
    rows, before = [(low, 0.0)], 0.0
    for place, opacity in ((0.35, 0.02), (0.55, 0.2), (0.8, 0.7)):
        value = low + place * (high - low)
        rows += [(value, before), (value, opacity)]
        before = opacity
    return (*rows, (high, before))


FUNCTIONS = {"smooth": smooth, "narrow": peaks, "steps": steps}


def measure(path: str, function: str, step: float, filter: Any, size: int) -> Row:
    """Both pictures at one step, and their difference."""
    source, voxels = opened(path)
    low, high = float(voxels.min()), float(voxels.max())
    volume = Volume(path=path, cmap="viridis", clim=(low, high), opacity=FUNCTIONS[function](low, high))
    image, quality = ImageSettings(size=(size, size)), Quality(step=step, filter=filter)
    rendered = render_frame(Scene(volumes=(volume,), image=image, quality=quality), LoopbackChannel(), source)
    reference = timed(lambda: render_reference(rendered.scene, source.grid, voxels))
    difference = compare(np.asarray(rendered.image), reference.value, TOLERANCE)
    return {"function": function, "step": step, "reference_s": reference.wall, **asdict(difference)}


def main() -> None:
    data = positional("data", help="a data file; default: the sample mni152")
    filters = {"choices": ["exact", "hardware"], "default": "exact"}
    asked = options(__doc__, data=data, size=512, steps=[2.0, 1.0, 0.25], filter=filters)
    path = sample(asked.data)
    rows = (measure(path, *each, asked.filter, asked.size) for each in product(FUNCTIONS, asked.steps))
    head = "function | step | max | rms | pixels > 1e-5 | reference, s"
    cells = "{function} | {step:g} | {max:.2e} | {rms:.2e} | {count} | {reference_s:.1f}"
    write(asked, rows=show(head, cells, rows, f"{path}, {asked.size} × {asked.size}, filter {asked.filter}"))


if __name__ == "__main__":
    main()
