"""Calibration of `quality.max_error`: small pictures of a scene, drawn until settings keep the error bound.

All ranks draw them as they draw any frame. The texture unit's filter is compared with exact weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from clusterviz.comm import Channel
from clusterviz.frame.run import Image
from clusterviz.frame.work import Planning
from clusterviz.plan.accuracy import (
    COARSEST,
    SAFETY,
    VERIFIED_FINEST,
    Aim,
    Choice,
    Picked,
    Probe,
    choose,
    next_trial,
    pick_filter,
    reduced,
    verified,
    why_exact,
)
from clusterviz.plan.content import Filter
from clusterviz.plan.estimate import Trial, difference, largest
from clusterviz.scene.values import Quality, Scene


@dataclass(frozen=True)
class SmallPicture:
    """Small picture; all but the image is the same on every rank."""

    image: Image | None  # on rank 0 only
    samples: int  # sum over all ranks
    seconds: float  # of drawing, on the slowest rank
    filter: Filter  # of the plan
    is_textured: bool  # True if all ranks draw by OpenGL
    volumes: int  # of the plan


Draw = Callable[[Scene], Planning[SmallPicture]]
"""Asks for the picture of a scene whose settings are given; collective."""


REPEATS = 3
"""Timed pictures of each filter; the fastest counts."""


class TextureUnit:
    """Comparison of the texture unit's filter with exact weights; every method is collective.

    Parameters
    ----------
    small : scene of a small picture, with all settings
    channel : to the other ranks
    draw : asks for a small picture

    Attributes
    ----------
    samples : of all pictures so far
    """

    def __init__(self, small: Scene, channel: Channel, draw: Draw) -> None:
        qualities = (small.quality.model_copy(update={"filter": name}) for name in ("exact", "hardware"))
        self._scenes = [small.model_copy(update={"quality": quality}) for quality in qualities]
        self._channel, self._draw = channel, draw
        self.samples = 0

    def error(self, aim: Aim) -> Planning[float]:
        """Estimate the error that the texture unit adds to the whole picture."""
        exact, textured = (yield from self._drawn(0)).image, (yield from self._drawn(1)).image
        added = 0.0
        if exact is not None and textured is not None:
            added = largest(difference(exact, textured), aim.pixels) * (2 * SAFETY if aim.jumps else SAFETY)
        return self._channel.broadcast(added)

    def share(self) -> Planning[float]:
        """Return its time relative to that of exact weights, on the slowest rank."""
        fastest = []
        for number in range(len(self._scenes)):
            yield from self._drawn(number)  # compiles shaders, and stores bricks for this filter
            seconds = list[float]()
            for _ in range(REPEATS):
                seconds.append((yield from self._drawn(number)).seconds)
            fastest.append(min(seconds))
        return fastest[1] / max(fastest[0], 1e-9)

    def _drawn(self, number: int) -> Planning[SmallPicture]:
        drawn = yield from self._draw(self._scenes[number])
        self.samples += drawn.samples
        return drawn


FIRST_SIDE = 64
"""Pixels along the longer side of a first picture, which measures the covered part of the view."""
SHARE, LEAST_PIXELS = 1 / 64, 1500
"""Share of the covered pixels to draw, and their least number."""
FOLLOWED, LEAST_FOLLOWED, LEAST_AT_JUMPS = 1 / 10, 100, 400
"""When an earlier choice is followed: share of a frame's samples for these pictures, and the least number of covered
pixels, in general and where the opacity jumps, so that single pixels have far larger errors than all others."""
RESIDUAL = 1 / 64
"""Share of the bound for early ray termination in these pictures."""


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration; the same on every rank."""

    scene: Scene  # that was calibrated
    choice: Choice  # of step and classification
    covered: float  # share of the picture that the volume covers
    pixels: int  # of each small picture
    samples: int  # of all small pictures, on all ranks
    filter: Picked  # that was picked
    verified: bool = False  # True if the choice was checked in all pixels, not in a sample of them
    worse: float = 1.0  # error in all pixels over that estimated in a sample of them, at least 1


class _Verdict(NamedTuple):
    """Decision of rank 0 after a picture: the next trial, or the choice."""

    trial: Trial | None
    choice: Choice | None
    covered: float


def calibrate(
    scene: Scene, aim: Aim, channel: Channel, draw: Draw, followed: Calibration | None = None
) -> Planning[Calibration]:
    """Find the settings that keep a scene's error bound; collective.

    Parameters
    ----------
    scene : completed, with a volume and `quality.max_error`
    aim : error bound and allowed settings
    channel : to the other ranks
    draw : asks for the picture of a scene
    followed : earlier calibration whose filter is kept; None: compare all settings
    """
    samples, covered = 0, followed.covered if followed else 1.0
    if followed is None:
        first = yield from draw(_small(scene, Trial("post", COARSEST), FIRST_SIDE / max(scene.image.size)))
        samples, covered = first.samples, channel.broadcast(_covered(first.image))
    scale, pictures = math.sqrt(_share(aim, covered)), dict[Trial, Image]()
    trial, choice = next_trial(pictures, aim), None
    while trial is not None:
        small = yield from draw(_small(scene, trial, scale))
        samples += small.samples
        if small.image is not None:
            pictures[trial] = small.image
        verdict = channel.broadcast(_judged(pictures, aim, small.image))
        assert verdict is not None, "rank 0 has the picture"
        trial, choice, covered = verdict
    assert choice is not None, "rank 0 has chosen where it wants no further picture"
    if followed is not None:
        picked, choice = followed.filter, replace(choice, error=choice.error + followed.filter.error)
    elif why := why_exact(small.filter, small.volumes, small.is_textured):
        picked = Picked("exact", reason=why)
    else:
        scaled = _small(scene, choice.trial, scale)
        picked, choice, taken = yield from _picked(scaled, pictures, choice, aim, channel, draw)
        samples += taken
    pixels = math.prod(_small(scene, choice.trial, scale).image.size)
    worse = 1.0
    if aim.jumps or not followed:
        left = replace(aim, bound=aim.bound - (0.0 if followed else picked.error))
        choice = replace(choice, error=choice.error - picked.error)
        choice, worse, taken = yield from _verified(scene, choice, left, channel, draw, is_first=not followed)
        choice, samples = replace(choice, error=choice.error + picked.error), samples + taken
    return Calibration(scene, choice, covered, pixels, samples, picked, aim.jumps or not followed, worse)


def covered_pixels(aim: Aim, covered: float) -> float:
    """Return the covered pixels of a small picture, if the volume covers a share `covered` of the whole picture."""
    return _share(aim, covered) * covered * aim.pixels


def chosen(scene: Scene, trial: Trial, early_termination: float, filter: str = "exact") -> Scene:
    """Return the scene with chosen settings, and `pixel` float32 until the work is assigned."""
    settings = {"step": trial.step, "classification": trial.classification, "filter": filter, "pixel": "float32"}
    return _with(scene, **settings, early_termination=early_termination)


def _picked(
    small: Scene, pictures: dict[Trial, Image], choice: Choice, aim: Aim, channel: Channel, draw: Draw
) -> Planning[tuple[Picked, Choice, int]]:
    """Pick the filter, timed only if its error fits the bound; returns it, the adapted choice, and samples taken."""
    unit = TextureUnit(small, channel, draw)
    error = yield from unit.error(aim)
    less = reduced(aim, error)
    share = (yield from unit.share()) if less else None
    instead = channel.broadcast(choose(pictures, less) if less and pictures else None)
    picked, choice = pick_filter(Probe(error, share), choice, instead, aim)
    return picked, choice, unit.samples


def _verified(
    scene: Scene, choice: Choice, aim: Aim, channel: Channel, draw: Draw, *, is_first: bool
) -> Planning[tuple[Choice, float, int]]:
    """Verify a choice, or shorten its step, by whole pictures.

    Needed because a sample of pixels misses the errors of single pixels, which are far larger than all others where
    something jumps. Long steps are compared with shorter ones, all others with longer ones. A first view that shows
    nothing is drawn down to the shortest step, since blank pictures say nothing of what they miss.

    Returns the choice, the error of the first that was tried over its estimate, at least 1, and the samples taken.
    """
    level = choice.trial.level
    # Slabs are no longer than those of the coarsest.
    least = aim.witness if is_first else COARSEST + 2
    finest = level + max(0, math.ceil(least - level))
    trial, pictures, samples = choice.trial._replace(level=min(level, finest - 2)), list[Image](), 0
    coarser, errors = round(finest - level), list[float]()
    # Below a sixteenth of the bound a quotient says nothing of errors near the bound.
    estimated = max(choice.error - aim.residual, aim.target / 16)
    while True:
        drawn = yield from draw(_small(scene, trial, 1.0))
        samples += drawn.samples
        if drawn.image is not None:
            pictures.append(drawn.image)
        if is_first and finest <= trial.level <= VERIFIED_FINEST - 1 and channel.broadcast(_is_blank(drawn.image)):
            finest, coarser = finest + 1, coarser + 1
        while trial.level >= finest and coarser >= 0:
            errors.append(channel.broadcast(verified(pictures, aim, trial.level, coarser) if pictures else 0.0))
            if errors[-1] <= aim.bound or (coarser == 0 and trial.level + 1 > VERIFIED_FINEST):
                found = replace(choice, trial=trial._replace(level=trial.level - coarser), error=errors[-1])
                return found, max(1.0, (errors[0] - aim.residual) / estimated), samples
            coarser -= 1
        trial, coarser = trial._replace(level=trial.level + 1), max(coarser, 0)


def _judged(pictures: dict[Trial, Image], aim: Aim, image: Image | None) -> _Verdict | None:
    if image is None:
        return None
    trial = next_trial(pictures, aim)
    return _Verdict(trial, None if trial else choose(pictures, aim), _covered(image))


def _small(scene: Scene, trial: Trial, scale: float) -> Scene:
    """Return the scene with the settings of a trial, scaled in both directions."""
    width, height = (max(1, round(min(1.0, scale) * side)) for side in scene.image.size)
    parts = {
        "image": scene.image.model_copy(update={"size": (width, height)}),
        "cluster": scene.cluster.model_copy(update={"compositing": "serial", "codec": "raw", "transport": "messages"}),
    }
    residual = RESIDUAL * (scene.quality.max_error or 1.0)
    return chosen(scene, trial, residual).model_copy(update=parts)


def _with(scene: Scene, **settings: object) -> Scene:
    quality = Quality.model_validate(scene.quality.model_dump() | settings | {"max_error": None, "adaptive": 0.0})
    return scene.model_copy(update={"quality": quality})


def _covered(image: Image | None) -> float:
    """Return the covered share of a picture, at least one pixel; 1 on ranks without the picture."""
    return 1.0 if image is None else max(float(np.mean(np.any(image != 0, axis=-1))), 1 / image[..., 0].size)


def _is_blank(image: Image | None) -> bool:
    """Return whether a picture shows nothing; False on ranks without it."""
    return image is not None and not image.any()


def _share(aim: Aim, covered: float) -> float:
    """Return the share of pixels that small pictures have."""
    share, least = SHARE, LEAST_PIXELS
    if aim.last is not None:
        share, least = FOLLOWED / aim.first_cost, LEAST_AT_JUMPS if aim.jumps else LEAST_FOLLOWED
    return min(1.0, max(share, least / (covered * aim.pixels)))
