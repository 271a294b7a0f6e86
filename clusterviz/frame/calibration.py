"""`quality.max_error`: small pictures of a scene, drawn by all ranks as any frame is, until a setting holds the bound.

Rank 0 decides from the finished pictures, and the others follow, so all decide alike. Pictures are equal on any number
of ranks, and with bricks of any size, to rounding, and so is what is chosen: to a last bit of an estimate that lies on
an edge. `plan/accuracy.py` says how it is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from time import perf_counter

import numpy as np

from clusterviz.comm import Channel
from clusterviz.frame.run import Image
from clusterviz.plan.accuracy import COARSEST, Trial, choose, make_aim, next_trial
from clusterviz.report.accuracy import Accuracy
from clusterviz.scene.values import Quality, Scene

Draw = Callable[[Scene], tuple[Image | None, int]]
FIRST_SIDE = 64
"""Pixels along the longer side of a first picture, which only tells how much of the view is covered."""
SHARE, LEAST_PIXELS = 1 / 64, 1500
"""How many of the covered pixels are drawn: this share; and so many at least, where there are so many."""
RESIDUAL = 1 / 64
"""Share of the bound at which rays of these pictures end early."""


def calibrate(scene: Scene, channel: Channel, draw: Draw) -> Accuracy:
    """Find out which settings hold a scene's bound; collective.

    Parameters
    ----------
    scene : completed, with a volume and `quality.max_error`
    draw : the picture of a scene, on rank 0, and the samples that all ranks took; collective

    Returns
    -------
    accuracy : the same on every rank
    """
    began, aim = perf_counter(), make_aim(scene)
    pictures, samples = dict[Trial, Image](), 0
    image, _ = draw(_small(scene, Trial("post", COARSEST), FIRST_SIDE / max(scene.image.size)))
    scale = channel.broadcast(_scale(image, aim.pixels) if image is not None else 1.0)
    trial: Trial | None = Trial(aim.ways[0], COARSEST)
    while trial is not None:
        small = _small(scene, trial, scale)
        image, taken = draw(small)
        samples += taken
        if image is not None:
            pictures[trial] = image
        trial = channel.broadcast(next_trial(pictures, aim) if pictures else None)
    choice = channel.broadcast(choose(pictures, aim) if pictures else None)
    assert choice is not None, "rank 0 has the pictures"
    settings = (choice.trial.step, choice.trial.classification, aim.residual)
    cost = (math.prod(small.image.size), samples, perf_counter() - began)
    return Accuracy(aim.bound, choice.error, choice.error <= aim.bound, *settings, *cost)


def chosen(scene: Scene, accuracy: Accuracy) -> Scene:
    """The scene with the settings that were chosen, and nothing left to choose."""
    settings = {"step": accuracy.step, "classification": accuracy.classification, "filter": "exact"}
    return _with(scene, **settings, early_termination=accuracy.early_termination)


def _small(scene: Scene, trial: Trial, scale: float) -> Scene:
    """The scene as a trial asks for it, of some scale in both directions."""
    width, height = (max(1, round(min(1.0, scale) * side)) for side in scene.image.size)
    parts = {
        "image": scene.image.model_copy(update={"size": (width, height)}),
        "cluster": scene.cluster.model_copy(update={"compositing": "serial", "codec": "raw", "transport": "messages"}),
    }
    residual = RESIDUAL * (scene.quality.max_error or 1.0)
    quality = {"step": trial.step, "classification": trial.classification, "filter": "exact"}
    return _with(scene, **quality, early_termination=residual).model_copy(update=parts)


def _with(scene: Scene, **settings: object) -> Scene:
    quality = Quality.model_validate(scene.quality.model_dump() | settings | {"max_error": None, "adaptive": 0.0})
    return scene.model_copy(update={"quality": quality})


def _scale(image: Image, pixels: int) -> float:
    """How large pictures must be, from one that shows what is covered."""
    covered = max(float(np.mean(np.any(image != 0, axis=-1))), 1 / image[..., 0].size) * pixels
    return math.sqrt(min(1.0, max(SHARE, LEAST_PIXELS / covered)))
