"""How `quality.max_error` fares over an orbit: `python benchmarks/max_error_orbit.py [--views N] [--size S] [DATA…]`.

Each view is drawn by the loop, which follows its first choice from view to view, and once more by the first choice
alone; errors are largest differences from the picture at a step of 1/100 (smooth: 1/40). Prints a row of a table each.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from accuracy import FUNCTIONS
from measuring import Row, options, sample, show, write

from clusterviz.comm import LoopbackChannel
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.animation import scenes_along
from clusterviz.scene.overrides import with_settings

FIELDS = ["head", "hydrogen", "marschner-lobb", "shells"]
BOUNDS = (2 / 255, 1 / 255)


def compared(name: str, function: str, views: int, size: int) -> Iterator[Row]:
    """The rows of a volume and a transfer function."""
    values = (0.0, 255.0) if name == "head" else (0.0, 1.0)
    data = sample() if name == "head" else f"field:{name}:96"
    scene = scene_of_data(data, [f"image.size=[{size},{size}]"])
    scene = with_settings(scene, {"opacity": FUNCTIONS[function](*values), "clim": values, "cmap": "viridis"})
    fine = {"classification": "post", "step": 1 / 40} if function == "smooth" else {"classification": "pre-integrated"}
    truths = [drawn.image for drawn in frames(with_settings(scene, {"step": 1 / 100, **fine}), views)]
    for bound in BOUNDS:
        followed = frames(with_settings(scene, {"max_error": bound}), views)
        alone = frames(scene.model_copy(update={"quality": followed[0].scene.quality}), views)
        found = [drawn.statistics.accuracy for drawn in followed]
        samples = [sum(rank.samples for rank in drawn.statistics.per_rank) for drawn in followed]
        asked = [one.pilot_samples / taken for one, taken in zip(found, samples, strict=True)]
        ways = "".join(dict.fromkeys(one.classification[:4] for one in found))
        steps = sorted({round(1 / one.step, 1) for one in found})
        yield {
            "volume": name,
            "function": function,
            "bound": bound,
            "steps": f"1/{steps[0]:g} … 1/{steps[-1]:g}, {ways}",
            "expected": span([one.error for one in found]),
            "error": span(apart(followed, truths)),
            "alone": span(apart(alone, truths)),
            "first": asked[0],
            "then": np.mean(asked[1:]),
            "most": max(asked[1:]),
        }


def frames(scene: Scene, views: int) -> list[Any]:
    """The frames of an orbit."""
    with FrameLoop(scene, LoopbackChannel(), options=Options(overlap=False)) as loop:
        return [loop.frame(each, number) for number, each in enumerate(scenes_along(loop.scene, views, 360.0))]


def apart(drawn: list[Any], truths: list[Any]) -> list[float]:
    """The largest error of each picture."""
    return [float(np.abs(one.image - truth).max()) for one, truth in zip(drawn, truths, strict=True)]


def span(errors: list[float]) -> str:
    """The smallest and the largest."""
    return f"{min(errors) * 1e3:.2f} … {max(errors) * 1e3:.2f}"


def main() -> None:
    """Print the table."""
    data = {"names": ["data"], "nargs": "*", "default": FIELDS, "help": "head, or names of fields"}
    asked = options(__doc__, data=data, views=6, size=128, functions=list(FUNCTIONS))
    warnings.simplefilter("ignore")
    pairs = product(asked.data, asked.functions)
    rows = (row for pair in pairs for row in compared(*pair, asked.views, asked.size))
    head = "volume | transfer function | bound | steps | expected, 10⁻³ | error, 10⁻³ | by the first choice alone | "
    cells = "{volume} | {function} | {bound!m:.1f} | {steps} | {expected} | {error} | {alone} | {first:.2f} | "
    write(asked, rows=show(head + "pictures first | then, of a frame", cells + "{then:.2f}, at most {most:.2f}", rows))


if __name__ == "__main__":
    main()
