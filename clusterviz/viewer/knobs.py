"""Cost and error of quality settings, measured on small pictures of what is shown.

Each key is tried alone. The first of its values is the most exact one, with which the pictures of the others are
compared. Seconds are those of drawing, scaled to the whole picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.compare import compare
from clusterviz.scene.values import Scene

LONGEST_SIDE = 160
"""Longest side of the small pictures, pixels."""
VALUES = {"step": (0.25, 0.5, 1.0, 2.0, 4.0), "early_termination": (0.0, 0.01, 0.05)}
"""Values that are tried for keys of quality, the most exact one first; the scene's own is added."""


@dataclass(frozen=True)
class Trial:
    """Small picture of a scene with another value of one key of quality."""

    name: str
    value: float
    scene: Scene


@dataclass(frozen=True)
class Measurement:
    """Picture and seconds of a trial."""

    trial: Trial
    image: NDArray[np.float32]
    seconds: float


def trials(scene: Scene) -> list[Trial]:
    """Return the small pictures to draw of a completed scene; none if its settings are chosen by an error bound."""
    if scene.quality.max_error is not None:
        return []
    scale = min(1.0, LONGEST_SIDE / max(scene.image.size))
    size = tuple(max(1, round(side * scale)) for side in scene.image.size)
    image = scene.image.model_copy(update={"size": size, "layers": ()})
    small = scene.model_copy(update={"image": image, "annotations": type(scene.annotations)()})
    found = []
    for name, values in VALUES.items():
        for value in sorted({*values, getattr(scene.quality, name)}):
            quality = scene.quality.model_copy(update={name: value})
            found.append(Trial(name, value, small.model_copy(update={"quality": quality})))
    return found


def described(scene: Scene, measured: Sequence[Measurement]) -> list[dict[str, Any]]:
    """Return the measurements as clients are told. `scene`: completed, of the whole picture."""
    found = []
    for name in VALUES:
        mine = [each for each in measured if each.trial.name == name]
        pixels = [each.image.shape[0] * each.image.shape[1] for each in mine]
        width, height = scene.image.size
        choices = [
            {
                "value": each.trial.value,
                "seconds": each.seconds * width * height / count,
                "error": compare(each.image, mine[0].image).rms,
            }
            for each, count in zip(mine, pixels, strict=True)
        ]
        choices.sort(key=lambda each: each["seconds"])
        found.append({"key": f"quality.{name}", "value": getattr(scene.quality, name), "choices": choices})
    return found
