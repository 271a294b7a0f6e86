"""Calibration of `quality.max_error`: small pictures of a scene, drawn until a setting holds the bound.

All ranks draw them as they draw any frame. The texture unit's filter is tried beside exact weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from clusterviz.comm import Channel
from clusterviz.frame.run import Image
from clusterviz.plan.accuracy import COARSEST, SAFETY, VERIFIED_FINEST, Aim, Choice, choose, next_trial, verified
from clusterviz.plan.estimate import Trial, difference, largest
from clusterviz.plan.filter_and_pixel import Picked, Probe, pick_filter, reduced, why_exact
from clusterviz.plan.plan import Filter
from clusterviz.scene.values import Quality, Scene


@dataclass(frozen=True)
class SmallPicture:
    """A picture that was asked for; the same on every rank but for the image.

    Attributes
    ----------
    image : on rank 0 only
    samples : that all ranks took
    seconds : of drawing, on the slowest rank
    filter : of the plan
    is_textured : whether all ranks draw by OpenGL
    """

    image: Image | None
    samples: int
    seconds: float
    filter: Filter
    is_textured: bool


Draw = Callable[[Scene], SmallPicture]
"""Draws the picture of a scene whose settings are given; collective."""


TURNS = 3
"""Pictures of each that are timed; the fastest counts."""


class TextureUnit:
    """Pictures by the texture unit and by exact weights; every method is collective.

    Parameters
    ----------
    small : a small scene whose settings are given
    draw : a small picture

    Attributes
    ----------
    samples : that all of them took so far
    """

    def __init__(self, small: Scene, channel: Channel, draw: Draw) -> None:
        qualities = (small.quality.model_copy(update={"filter": name}) for name in ("exact", "hardware"))
        self._scenes = [small.model_copy(update={"quality": quality}) for quality in qualities]
        self._channel, self._draw = channel, draw
        self.samples = 0

    def error(self, aim: Aim) -> float:
        """What the texture unit adds to the error of the whole picture, estimated."""
        exact, textured = (self._drawn(scene).image for scene in self._scenes)
        added = 0.0
        if exact is not None and textured is not None:
            added = largest(difference(exact, textured), aim.pixels) * (2 * SAFETY if aim.jumps else SAFETY)
        return self._channel.broadcast(added)

    def share(self) -> float:
        """Its time beside that of exact weights, on the slowest rank."""
        fastest = []
        for scene in self._scenes:
            self._drawn(scene)  # compiles, and brings bricks as this filter has them stored
            fastest.append(min(self._drawn(scene).seconds for _ in range(TURNS)))
        return fastest[1] / max(fastest[0], 1e-9)

    def _drawn(self, scene: Scene) -> SmallPicture:
        drawn = self._draw(scene)
        self.samples += drawn.samples
        return drawn


FIRST_SIDE = 64
"""Pixels along the longer side of a first picture, which only tells how much of the view is covered."""
SHARE, LEAST_PIXELS = 1 / 64, 1500
"""How many of the covered pixels are drawn: this share; and so many at least, where there are so many."""
FOLLOWED, LEAST_FOLLOWED, LEAST_AT_JUMPS = 1 / 10, 100, 400
"""Where a choice is followed: this share of a frame's samples, for the pictures that are drawn in any case; and so many
of the covered pixels at least, more where the opacity jumps and single pixels are far worse than all others."""
RESIDUAL = 1 / 64
"""Share of the bound at which rays of these pictures end early."""


@dataclass(frozen=True)
class Calibration:
    """What small pictures led to; the same on every rank.

    Attributes
    ----------
    scene : for which
    choice : that was made
    covered : share of the picture that the volume covers
    pixels : of each of the small pictures
    samples : of all of them together, on all ranks
    filter : that was picked, where all was compared
    verified : whether the choice was checked in all pixels, and not in a sample of them
    """

    scene: Scene
    choice: Choice
    covered: float
    pixels: int
    samples: int
    filter: Picked
    verified: bool = False


class _Verdict(NamedTuple):
    """What rank 0 says of the pictures so far: what to draw next, or what to choose."""

    trial: Trial | None
    choice: Choice | None
    covered: float


def calibrate(scene: Scene, aim: Aim, channel: Channel, draw: Draw, followed: Calibration | None = None) -> Calibration:
    """Find out which settings hold a scene's bound; collective.

    Parameters
    ----------
    scene : completed, with a volume and `quality.max_error`
    aim : what is asked for
    draw : the picture of a scene; collective
    followed : what the choice follows from, which knows what the texture unit adds; None: all is compared
    """
    samples, covered = 0, followed.covered if followed else 1.0
    if followed is None:
        first = draw(_small(scene, Trial("post", COARSEST), FIRST_SIDE / max(scene.image.size)))
        samples, covered = first.samples, channel.broadcast(_covered(first.image))
    scale, pictures = math.sqrt(_share(aim, covered)), dict[Trial, Image]()
    trial, choice = next_trial(pictures, aim), None
    while trial is not None:
        small = draw(_small(scene, trial, scale))
        samples += small.samples
        if small.image is not None:
            pictures[trial] = small.image
        verdict = channel.broadcast(_judged(pictures, aim, small.image))
        assert verdict is not None, "rank 0 has the picture"
        trial, choice, covered = verdict
    assert choice is not None, "rank 0 has chosen where it wants no further picture"
    if followed is not None:
        picked, choice = followed.filter, replace(choice, error=choice.error + followed.filter.error)
    elif why := why_exact(small.filter, len(scene.volumes), small.is_textured):
        picked = Picked("exact", reason=why)
    else:
        picked, choice, taken = _picked(_small(scene, choice.trial, scale), pictures, choice, aim, channel, draw)
        samples += taken
    pixels = math.prod(_small(scene, choice.trial, scale).image.size)
    if aim.jumps:
        left = replace(aim, bound=aim.bound - (0.0 if followed else picked.error))
        choice, taken = _verified(scene, choice, left, channel, draw)
        choice, samples = replace(choice, error=choice.error + picked.error), samples + taken
    return Calibration(scene, choice, covered, pixels, samples, picked, aim.jumps)


def covered_pixels(aim: Aim, covered: float) -> float:
    """How many of those that the volume covers a small picture has; that being a share of the whole picture."""
    return _share(aim, covered) * covered * aim.pixels


def chosen(scene: Scene, trial: Trial, early_termination: float, filter: str = "exact") -> Scene:
    """The scene with the settings that were chosen, and nothing left to choose before it is dealt out."""
    settings = {"step": trial.step, "classification": trial.classification, "filter": filter, "pixel": "float32"}
    return _with(scene, **settings, early_termination=early_termination)


def _picked(
    small: Scene, pictures: dict[Trial, Image], choice: Choice, aim: Aim, channel: Channel, draw: Draw
) -> tuple[Picked, Choice, int]:
    """The filter, the choice that goes with it, and the samples that it took to pick; timed only where it fits."""
    unit = TextureUnit(small, channel, draw)
    error = unit.error(aim)
    less = reduced(aim, error)
    share = unit.share() if less else None
    instead = channel.broadcast(choose(pictures, less) if less and pictures else None)
    picked, choice = pick_filter(Probe(error, share), choice, instead, aim)
    return picked, choice, unit.samples


def _verified(scene: Scene, choice: Choice, aim: Aim, channel: Channel, draw: Draw) -> tuple[Choice, int]:
    """The choice, or one with a shorter step, by the whole picture beside two of longer steps; and samples taken.

    Where single pixels are far worse than all others, no sample of pixels tells of them.
    """
    finest = max(choice.trial.level, COARSEST + 2)  # slabs are no longer than those of the coarsest
    trial, pictures, samples = choice.trial._replace(level=finest - 2), list[Image](), 0
    while True:
        drawn = draw(_small(scene, trial, 1.0))
        samples += drawn.samples
        if drawn.image is not None:
            pictures = [*pictures[-2:], drawn.image]
        if trial.level >= finest:
            error = channel.broadcast(verified(pictures, aim) if pictures else 0.0)
            if error <= aim.bound or trial.level + 1 > VERIFIED_FINEST:
                return replace(choice, trial=trial, error=error), samples
        trial = trial._replace(level=trial.level + 1)


def _judged(pictures: dict[Trial, Image], aim: Aim, image: Image | None) -> _Verdict | None:
    if image is None:
        return None
    trial = next_trial(pictures, aim)
    return _Verdict(trial, None if trial else choose(pictures, aim), _covered(image))


def _small(scene: Scene, trial: Trial, scale: float) -> Scene:
    """The scene as a trial asks for it, of some scale in both directions."""
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
    """The share of a picture, on rank 0, that shows anything; a pixel's at least."""
    return 1.0 if image is None else max(float(np.mean(np.any(image != 0, axis=-1))), 1 / image[..., 0].size)


def _share(aim: Aim, covered: float) -> float:
    """How many of the pixels are drawn."""
    share, least = SHARE, LEAST_PIXELS
    if aim.last is not None:
        share, least = FOLLOWED / aim.first_cost, LEAST_AT_JUMPS if aim.jumps else LEAST_FOLLOWED
    return min(1.0, max(share, least / (covered * aim.pixels)))
