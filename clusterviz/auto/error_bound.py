"""Settings of each frame under `quality.max_error`: calibrated for the first frame, and adapted to later ones.

Settings that keep the bound in one view may break it in another, or be needlessly expensive there. So for each new
camera or transfer function, pictures around the last choice are drawn, at a small share of a frame's samples, and the
choice is adapted. If it has changed much, or anything else has changed, all settings are compared again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter

from clusterviz.auto.calibration import LEAST_PIXELS, Calibration, SmallPicture, calibrate, chosen, covered_pixels
from clusterviz.comm import mark_agreed
from clusterviz.composite import rounding_bound
from clusterviz.content.diff import check_same_volume
from clusterviz.errors import SceneError
from clusterviz.frame.run import Run
from clusterviz.frame.work import Planning
from clusterviz.partition import Piece
from clusterviz.plan.accuracy import Aim, Picked, has_strayed, make_aim, pick_pixel
from clusterviz.plan.estimate import Trial
from clusterviz.plan.plan import Plan
from clusterviz.report.decisions import Accuracy
from clusterviz.scene.values import Scene

FOLLOWED_FOR = 8
"""Least number of frames between full calibrations, each of which costs as much as several frames."""


class ErrorBoundController:
    """Controller of a loop's settings from frame to frame; the same on every rank.

    `draw`: asks for the picture of a scene whose settings are given.
    """

    def __init__(self, draw: Callable[[Run, Scene], Planning[SmallPicture]]) -> None:
        self._draw = draw
        self._anew: Calibration | None = None
        self._last: Calibration | None = None
        self._followed_for = 0

    def settle(self, run: Run, scene: Scene, spacing: float) -> Planning[tuple[Scene, Accuracy]]:
        """Return the scene with settings that keep its `quality.max_error`; collective.

        `scene`: completed, with a volume and the bound. `spacing`: smallest distance of the volumes' samples, world
        units. Raises SceneError: on every rank: no settings keep the bound for certain.
        """
        began, aim = perf_counter(), _agreed_aim(scene, spacing)
        found, samples = yield from self._found(run, scene, aim)
        trial, error, residual = found.choice.trial, found.choice.error, _for_the_step(aim, found.filter).residual
        settings = (trial.step, trial.classification, found.filter.value, residual, "float32")
        cost = (found.pixels if samples else 0, samples, perf_counter() - began)
        if error > aim.bound:
            raise mark_agreed(_out_of_reach(aim.bound, error, trial))
        accuracy = Accuracy(aim.bound, error, *settings, *cost, _reasons(found), found.verified)
        return chosen(scene, trial, residual, found.filter.value), accuracy

    def _found(self, run: Run, scene: Scene, aim: Aim) -> Planning[tuple[Calibration, int]]:
        last, anew, samples = self._last, self._anew, 0
        if last and anew and _can_follow(last, scene, aim):
            if scene == last.scene:
                return last, 0
            following = _following(last, anew, scene, aim)
            found = self._last = yield from self._calibrated(run, scene, following, last)
            self._followed_for += 1
            if self._followed_for < FOLLOWED_FOR or not has_strayed(found.choice, anew.choice, aim):
                return found, found.samples
            samples = found.samples
        found = self._anew = self._last = yield from self._calibrated(run, scene, aim)
        self._followed_for = 0
        return found, samples + found.samples

    def _calibrated(
        self, run: Run, scene: Scene, aim: Aim, followed: Calibration | None = None
    ) -> Planning[Calibration]:
        with run.unreported("accuracy") as unreported:
            return (yield from calibrate(scene, aim, run.channel, partial(self._draw, unreported), followed))


def with_pixel(
    scene: Scene, plan: Plan, pieces: Sequence[Piece], accuracy: Accuracy, ranks: int
) -> tuple[Scene, Accuracy]:
    """Choose the format of partial images by the rest of the error bound; returns the changed scene and accuracy.

    Parameters
    ----------
    scene : with `pixel` float32
    plan, pieces : of its frame
    accuracy : of the settings so far
    ranks : that draw
    """
    # Images in the same tile may cover each other.
    images = max(Counter(piece.rect for piece in pieces).values(), default=0)
    picked = pixel_of(plan, accuracy, images, ranks)
    quality = scene.quality.model_copy(update={"pixel": picked.value})
    reasons = {**accuracy.reasons, "pixel": picked.reason}
    accuracy = replace(accuracy, error=accuracy.error + picked.error, pixel=picked.value, reasons=reasons)
    return scene.model_copy(update={"quality": quality}), accuracy


def pixel_of(plan: Plan, accuracy: Accuracy, images: int, ranks: int) -> Picked:
    """Pick the format of partial images by the rest of the bound, if up to `images` cover each other."""
    bounds = {name: rounding_bound(name, images) for name in ("uint8", "float16")}
    return pick_pixel(bounds, accuracy.max_error - accuracy.error, ranks, plan.blend_mode.traits.composited)


def _agreed_aim(scene: Scene, spacing: float) -> Aim:
    """Return the aim, which is the same on every rank, as is its error."""
    try:
        return make_aim(scene, spacing)
    except SceneError as error:
        raise mark_agreed(error) from None


def _can_follow(last: Calibration, scene: Scene, aim: Aim) -> bool:
    """True if only camera and transfer function differ, and the last classification is still allowed."""
    try:
        check_same_volume(last.scene, scene)
    except SceneError:
        return False
    return last.scene.quality == scene.quality and last.choice.trial.classification in aim.classifications


def _following(last: Calibration, anew: Calibration, scene: Scene, aim: Aim) -> Aim:
    """Return the aim of an adaptation; with few pixels and the same transfer function the step may only get shorter."""
    aim = _for_the_step(aim, last.filter)
    if not aim.jumps:  # where something jumps, all views are verified in all pixels
        aim = replace(aim, safety=aim.safety * anew.worse)
    following = aim.following(last.choice.trial)
    if covered_pixels(following, last.covered) >= LEAST_PIXELS or scene.entries != anew.scene.entries:
        return following
    return aim.following(last.choice.trial, coarsest=anew.choice.trial.level)


def _for_the_step(aim: Aim, filter: Picked) -> Aim:
    """Subtract the filter's error from the bound; the rest is for the step and early ray termination."""
    return replace(aim, bound=aim.bound - filter.error) if filter.error else aim


def _out_of_reach(bound: float, error: float, trial: Trial) -> SceneError:
    nearest = f"about {error:.2g} at the settings that come nearest, step {trial.step:.3g}, {trial.classification}"
    allowed = f"at least {error:.2g}, or null and settings of your own"
    return SceneError(f"{bound:.3g} is out of reach", where="quality.max_error", found=nearest, allowed=allowed)


def _reasons(found: Calibration) -> dict[str, str]:
    return {
        "step": "the longest that is expected to hold the bound",
        "classification": found.choice.reason,
        "filter": found.filter.reason,
        "early_termination": "an eighth of the bound is for rays that end early",
    }
