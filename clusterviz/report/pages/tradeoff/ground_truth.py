"""The picture without error: drawn with ever shorter steps until it changes no more, and how well it is known.

By the float64 reference where that is quick enough; else by the renderer itself at its most exact settings, which is
then held against the reference at a size that is quick enough. Which of them it was, and the error that is left, are
part of the result: no error below it can be told from none.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data import open_volume
from clusterviz.errors import ClustervizError
from clusterviz.image import compare
from clusterviz.reference import render_reference
from clusterviz.report.pages.tradeoff.knobs import exact_settings
from clusterviz.scene.settings import with_settings
from clusterviz.scene.values import Scene

Floats = NDArray[np.float64]
Draw = Callable[[Scene, float], NDArray[Any]]
"""From a scene and a step to a picture, (h, w, 4)."""

GOAL = 1e-4
"""Halving the step may change the picture by this much: 1/40 of a level of 8 bits."""
COARSEST = 0.25
REFERENCE_STEP = 1 / 8
"""The reference is taken where it can reach this step, below all that are measured, within the budget."""
CHECK_WIDTH, CHECK_SHARE = 64, 0.25
"""The renderer is checked at this width, with a step for which the reference takes this share of the budget."""
MAX_REFERENCE_BYTES = 1 << 30
"""The reference holds the whole volume in memory."""


@dataclass(frozen=True)
class Halving:
    """How far two pictures are apart, one with half the step of the other."""

    step: float
    max: float
    rms: float


@dataclass(frozen=True)
class GroundTruth:
    """The picture that all others are measured against.

    Attributes
    ----------
    picture : float64 (h, w, 4), premultiplied
    source : "reference" (float64 NumPy) or "renderer"
    why : the reason for the choice
    step : with which it was drawn, in voxels
    max, rms : estimate of its own error
    halvings : the changes from step to step, the last one being the estimate
    checked : (max, rms, step, width) of the renderer's distance from float64 at a small size; None for the reference
        itself, and where it cannot draw the scene
    """

    picture: Floats
    source: str
    why: str
    step: float
    max: float
    rms: float
    halvings: tuple[Halving, ...]
    checked: tuple[float, float, float, int] | None = None


def converge(draw: Callable[[float], NDArray[Any]], budget_seconds: float) -> tuple[NDArray[Any], list[Halving]]:
    """Halve the step until the picture changes by no more than `GOAL`, or the next one would not end in time.

    Where an error falls to half or less with the step, as it does for every transfer function without a pole, what is
    left after the last halving is no more than what that changed.

    Parameters
    ----------
    draw : makes the picture; its time is taken to double with each halving
    budget_seconds : for all pictures together; two are drawn in any case

    Returns
    -------
    picture : with the shortest step
    halvings : at least one
    """
    started, step = perf_counter(), COARSEST
    picture, halvings = draw(step), list[Halving]()
    seconds = perf_counter() - started
    while True:
        began, step = perf_counter(), step / 2
        finer = draw(step)
        difference = compare(finer.astype(np.float64), picture.astype(np.float64))
        halvings.append(Halving(step, difference.max, difference.rms))
        picture, seconds = finer, perf_counter() - began
        if difference.max <= GOAL or perf_counter() - started + 2 * seconds > budget_seconds:
            return picture, halvings


def find_ground_truth(scene: Scene, renderer: Draw, budget_seconds: float) -> GroundTruth:
    """The picture without error.

    Parameters
    ----------
    scene : completed; all of its settings that add an error are replaced by those that add none, for the renderer and
        for the reference alike, so that nothing but the step is left to differ
    renderer : draws a scene with its settings
    budget_seconds : roughly, for all of it
    """
    scene = with_settings(scene, exact_settings())
    reference, why = _reference_renderer(scene)
    if reference is None:
        return _converged(renderer, "renderer", why, scene, budget_seconds)
    small = _resized(scene, CHECK_WIDTH)
    small_seconds = _seconds(lambda: reference(small, 1.0))
    # Each halving takes as long as all pictures before it together.
    seconds = 2 * small_seconds * _pixels(scene) / _pixels(small) / REFERENCE_STEP
    if seconds <= budget_seconds:
        why = f"it takes about {seconds:.0f} s to a step of {REFERENCE_STEP:g}, of {budget_seconds:.0f} s allowed"
        return _converged(reference, "reference", why, scene, budget_seconds)
    takes = f"the reference would take about {seconds:.0f} s to a step of {REFERENCE_STEP:g}"
    why = f"{takes}, more than {budget_seconds:.0f} s"
    truth = _converged(renderer, "renderer", why, scene, budget_seconds)
    affordable = max(truth.step, 2.0 ** math.ceil(math.log2(small_seconds / (CHECK_SHARE * max(1.0, budget_seconds)))))
    return _checked(truth, renderer, reference, small, affordable)


def _converged(draw: Draw, source: str, why: str, scene: Scene, budget_seconds: float) -> GroundTruth:
    """The truth by one of the two ways."""
    picture, halvings = converge(lambda step: draw(scene, step), budget_seconds)
    last = halvings[-1]
    return GroundTruth(picture.astype(np.float64), source, why, last.step, last.max, last.rms, tuple(halvings))


def _checked(truth: GroundTruth, renderer: Draw, reference: Draw, small: Scene, step: float) -> GroundTruth:
    """The renderer's truth with its own error added, measured at a small size against float64 with the same step."""
    difference = compare(renderer(small, step).astype(np.float64), reference(small, step))
    return replace(
        truth,
        max=truth.max + difference.max,
        rms=math.hypot(truth.rms, difference.rms),
        checked=(difference.max, difference.rms, step, small.image.size[0]),
    )


def _reference_renderer(scene: Scene) -> tuple[Draw | None, str]:
    """The float64 reference of the scene as a function of scene and step, or why there is none."""
    sources = [open_volume(volume) for volume in scene.volumes]
    if sum(math.prod(one.grid.shape_zyx) * one.dtype.itemsize for one in sources) > MAX_REFERENCE_BYTES:
        return None, f"the reference holds no more than {MAX_REFERENCE_BYTES >> 30} GiB of voxels in memory"
    grids = [one.grid for one in sources]
    voxels = [one.read((0, 0, 0), grid.shape_zyx) for one, grid in zip(sources, grids, strict=True)]

    def reference(of: Scene, step: float) -> Floats:
        return render_reference(of, grids, voxels, step)

    try:
        reference(_resized(scene, 2), 8.0)
    except ClustervizError as error:
        return None, f"the reference cannot draw this scene ({error})"
    return reference, ""


def _resized(scene: Scene, width: int) -> Scene:
    """The scene at most so wide, of about the same shape."""
    columns, rows = scene.image.size
    share = min(1.0, width / max(columns, rows))
    size = (max(1, round(columns * share)), max(1, round(rows * share)))
    return scene.model_copy(update={"image": scene.image.model_copy(update={"size": size})})


def _pixels(scene: Scene) -> int:
    return math.prod(scene.image.size)


def _seconds(work: Callable[[], object]) -> float:
    started = perf_counter()
    work()
    return perf_counter() - started
