"""How `quality.max_error` fares over an orbit: `python benchmarks/max_error_orbit.py [--views N] [--size S] [DATA…]`.

Each view is drawn by the loop, which follows its first choice from view to view, and once more by the first choice
alone; errors are largest differences from the picture at a step of 1/100 (smooth: 1/40). Prints a row of a table each.
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import numpy as np
from accuracy import FUNCTIONS

from clusterviz.comm import LoopbackChannel
from clusterviz.data.samples import fetch_sample
from clusterviz.frame import FrameLoop, Options
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.animation import scenes_along
from clusterviz.scene.overrides import with_settings

FIELDS = ("head", "hydrogen", "marschner-lobb", "shells")
BOUNDS = (2 / 255, 1 / 255)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", nargs="*", default=FIELDS, help="head, or names of fields")
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--functions", nargs="*", default=list(FUNCTIONS))
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    print(
        "| volume | transfer function | bound | steps | expected, 10⁻³ | error, 10⁻³ | by the first choice alone |",
        end="",
    )
    print(" pictures first | then, of a frame |")
    print("|---" * 9 + "|")
    for name in arguments.data:
        for function in arguments.functions:
            compared(name, function, arguments.views, arguments.size)


def compared(name: str, function: str, views: int, size: int) -> None:
    """The rows of a volume and a transfer function."""
    values = (0.0, 255.0) if name == "head" else (0.0, 1.0)
    data = str(fetch_sample("mni152")) if name == "head" else f"field:{name}:96"
    scene = scene_of_data(data, [f"image.size=[{size},{size}]"])
    scene = with_settings(scene, {"opacity": FUNCTIONS[function](*values), "clim": values, "cmap": "viridis"})
    fine = {"classification": "post", "step": 1 / 40} if function == "smooth" else {"classification": "pre-integrated"}
    truths = [drawn.image for drawn in frames(with_settings(scene, {"step": 1 / 100, **fine}), views)]
    for bound in BOUNDS:
        followed = frames(with_settings(scene, {"max_error": bound}), views)
        quality = followed[0].scene.quality
        alone = [drawn.image for drawn in frames(scene.model_copy(update={"quality": quality}), views)]
        found = [drawn.statistics.accuracy for drawn in followed]
        samples = [sum(rank.samples for rank in drawn.statistics.per_rank) for drawn in followed]
        asked = [one.pilot_samples / taken for one, taken in zip(found, samples, strict=True)]
        ways = "".join(dict.fromkeys(one.classification[:4] for one in found))
        steps = sorted({round(1 / one.step, 1) for one in found})
        cells = (
            *(name, function, f"{bound * 1e3:.1f}", f"1/{steps[0]:g} … 1/{steps[-1]:g}, {ways}"),
            *(span([one.error for one in found]), span(apart([drawn.image for drawn in followed], truths))),
            *(span(apart(alone, truths)), f"{asked[0]:.2f}", f"{np.mean(asked[1:]):.2f}, at most {max(asked[1:]):.2f}"),
        )
        print(f"| {' | '.join(cells)} |", flush=True)


def frames(scene: Scene, views: int) -> list[Any]:
    """The frames of an orbit."""
    with FrameLoop(scene, LoopbackChannel(), options=Options(overlap=False)) as loop:
        return [loop.frame(each, number) for number, each in enumerate(scenes_along(loop.scene, views, 360.0))]


def apart(images: list[Any], truths: list[Any]) -> list[float]:
    """The largest error of each picture."""
    return [float(np.abs(image - truth).max()) for image, truth in zip(images, truths, strict=True)]


def span(errors: list[float]) -> str:
    """The smallest and the largest."""
    return f"{min(errors) * 1e3:.2f} … {max(errors) * 1e3:.2f}"


if __name__ == "__main__":
    main()
