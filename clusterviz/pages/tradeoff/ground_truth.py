"""Ground truth: a picture converged by halving the step, with an estimate of its own error.

It is drawn by the float64 reference if that is fast enough, else by the renderer with its most exact settings, which is
then compared with the reference at a smaller size. Errors of other pictures below the ground truth's own cannot be
resolved.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.loopback import LoopbackChannel
from clusterviz.content.reference_data import become, data_of, reference_data, samples_of, why_unchecked
from clusterviz.errors import ClustervizError
from clusterviz.frame import Options, Run, prepare
from clusterviz.image import compare
from clusterviz.pages.tradeoff.knobs import exact_settings
from clusterviz.reference import render_lens
from clusterviz.scene.lens import lens_points
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Scene

Floats = NDArray[np.float64]
Draw = Callable[[Scene, float], NDArray[Any]]
"""Function that draws a scene with a step; the picture is (h, w, 4)."""

GOAL = 1e-4
"""Largest change of the picture by the last halving of the step; 1/40 of a level of 8 bits."""
COARSEST = 0.25
REFERENCE_STEP = 1 / 8
"""The reference is used if it reaches this step, shorter than all steps measured, within the budget."""
CHECK_WIDTH, CHECK_SHARE = 64, 0.25
"""Width of the check of the renderer, and the share of the budget that the reference may take for it."""
MAX_REFERENCE_BYTES = 1 << 30
"""Largest volume for the reference, which holds it in memory."""


@dataclass(frozen=True)
class Halving:
    """Difference between the picture with a step and the one with twice the step."""

    step: float
    max: float
    rms: float


@dataclass(frozen=True)
class GroundTruth:
    """Picture with which all others are compared.

    `checked`: (max, rms, step, width) of the difference between renderer and reference at a small size; None for the
    reference itself, or if it cannot draw the scene.
    """

    picture: Floats  # float64 (h, w, 4), premultiplied
    source: str  # "reference" (float64 NumPy) or "renderer"
    why: str
    step: float  # step in voxels
    max: float
    rms: float
    halvings: tuple[Halving, ...]
    checked: tuple[float, float, float, int] | None = None


def converge(draw: Callable[[float], NDArray[Any]], budget_seconds: float) -> tuple[NDArray[Any], list[Halving]]:
    """Halve the step until the picture changes by at most `GOAL`, or the next halving would exceed the budget.

    If halving the step at least halves the error, as for every transfer function without a pole, the remaining error is
    at most the last change. `draw`: draws the picture; its time is assumed to double with each halving.
    `budget_seconds`: time limit of all pictures; at least two are drawn. Returns at least one halving.
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
    """Return the ground truth of a scene.

    `scene`: a completed scene; settings with an error of their own are replaced by exact ones, so that renderer and
    reference differ by the step only. `budget_seconds`: approximate time limit.
    """
    scene = with_settings(scene, exact_settings())
    reference, why = _reference_renderer(scene, CHECK_SHARE * max(1.0, budget_seconds))
    if reference is None:
        return _converged(renderer, "renderer", why, scene, budget_seconds)
    small = _resized(scene, CHECK_WIDTH)
    small_seconds = _seconds(lambda: reference(small, 1.0))
    # Each halving takes as long as all pictures before it.
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
    """Return the ground truth drawn by a function."""
    picture, halvings = converge(lambda step: draw(scene, step), budget_seconds)
    last = halvings[-1]
    return GroundTruth(picture.astype(np.float64), source, why, last.step, last.max, last.rms, tuple(halvings))


def _checked(truth: GroundTruth, renderer: Draw, reference: Draw, small: Scene, step: float) -> GroundTruth:
    """Add the renderer's error, measured against the reference at a small size with the same step."""
    difference = compare(renderer(small, step).astype(np.float64), reference(small, step))
    return replace(
        truth,
        max=truth.max + difference.max,
        rms=math.hypot(truth.rms, difference.rms),
        checked=(difference.max, difference.rms, step, small.image.size[0]),
    )


def _reference_renderer(scene: Scene, most_seconds: float = math.inf) -> tuple[Draw | None, str]:
    """Return the float64 reference as a function of scene and step, or None and the reason.

    `most_seconds`: that it may take for a picture of a few pixels, which large meshes take whole.
    """
    if why := why_unchecked(scene):
        return None, f"the reference {why}"
    if scene.refracts:
        return None, "the reference follows rays that bend one by one, which would take hours"
    made = become(scene)
    sources = samples_of(scene, made)
    if sum(math.prod(one.grid.shape_zyx) * one.dtype.itemsize for one in sources) > MAX_REFERENCE_BYTES:
        return None, f"the reference holds no more than {MAX_REFERENCE_BYTES >> 30} GiB of voxels in memory"
    if made:
        # Settings are complete, but not those of what flows become, which no file holds.
        scene = prepare(Run(LoopbackChannel(), Options()), scene)[0].scene
    found = reference_data(data_of(scene, made))

    def reference(of: Scene, step: float) -> Floats:
        of = scene.model_copy(update={"image": of.image})
        points = lens_points((of.quality.lens.eye_points or 1) if of.camera.aperture else 1)
        return render_lens(of, found.grids, found.voxels, points=points, step=step, **found.more)

    try:
        seconds = _seconds(lambda: reference(_resized(scene, 2), 8.0))
    except ClustervizError as error:
        return None, f"the reference cannot draw this scene ({error})"
    if seconds > most_seconds:
        return None, f"the reference takes {seconds:.0f} s for a few pixels"
    return reference, ""


def _resized(scene: Scene, width: int) -> Scene:
    """Return the scene with a picture whose larger side is at most a width."""
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
