"""Which settings hold a bound on the error at least cost: `quality.max_error`, decided from small pictures.

What a step costs in accuracy depends on the field, the transfer function and the view, and no bound from slopes alone
is within an order of magnitude of the truth. So the scene is drawn with few rays at steps of 2, 1, ½, … voxels, until
a step is found that holds, by the errors that `estimate.py` finds in these pictures. Both ways of classification go to
the same picture: only the one that promises to be cheaper is made finer, unless they contradict each other. From frame
to frame a choice is followed: of the way that was chosen, pictures around the last step tell whether it still holds.

An eighth of the bound is for rays that end early (what is behind them adds no more than the residual), the rest for the
step. docs/measurements/accuracy.md says how often the choice was right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.blend_mode import Classification, is_preintegrated
from clusterviz.plan.estimate import (
    FASTEST,
    SLOWEST,
    Pictures,
    Trial,
    apart,
    errors_of,
    largest,
    left_of,
    levels_of,
    logarithms,
    still_missing,
)
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.values import Scene, Volume

COARSEST, FINEST = -1, 6
"""Levels: a step is 2^-level voxels."""
FIRST = 1
"""Pictures down to this level are made in any case: coarse ones may agree on what they all miss."""
TERMINATION = 1 / 8
"""Share of the bound for rays that end early."""
SAFETY = 2.0
"""On all estimates."""
VERIFIED_SAFETY, VERIFIED_FINEST = 2.0, FINEST + 1
"""Where anything jumps, or nearly so, single pixels are far worse than all others, and no sample of pixels tells of
them: nothing is believed of a small picture before a finer one was drawn, and the choice is verified in all pixels,
with this factor on what is found, at steps down to this level."""
STEEP = 8.0
"""Full scales of opacity or colour that a transfer function changes by in the range of clim: steeper ones are jumps."""
STEADY = math.sqrt(2)
"""A step that still holds stays until another costs so many times less, so that frames that follow look alike."""
FEW = 500
"""Pixels that the volume covers below which only steps that were drawn are taken, as are steps of more than half a
voxel: how few slabs, or the same ones in all pixels, fall on the field is chance, and no step tells of another."""
STRAY = 1.5
"""Levels that a choice may be followed away from where both ways of classification were compared."""


@dataclass(frozen=True)
class Aim:
    """What is asked for.

    Attributes
    ----------
    bound : on the error
    pixels : of the whole picture
    ways : of classification, between which there is a choice
    jumps : whether opacity or colour jump, or nearly so, along rays
    is_cut : whether they do at clipping planes, or at the faces of one of several volumes, whatever the classification
    last : the choice of the frame before, which is followed; None where there is none
    coarsest : level of the longest step that may be chosen
    """

    bound: float
    pixels: int
    ways: tuple[Classification, ...]
    jumps: bool = False
    is_cut: bool = False
    last: Trial | None = None
    coarsest: float = COARSEST

    @property
    def target(self) -> float:
        """The share of the bound that is for the step."""
        return (1 - TERMINATION) * self.bound

    @property
    def residual(self) -> float:
        """The share that is for rays that end early."""
        return TERMINATION * self.bound

    @property
    def levels(self) -> tuple[int, ...]:
        """Of the pictures that are drawn in any case, each half the step of the one before."""
        finest = FIRST if self.last is None else min(max(math.ceil(self.last.level), FIRST) + self.jumps, FINEST)
        return (finest - 2, finest - 1, finest)

    @property
    def first_cost(self) -> float:
        """Of those pictures, of any way, beside a picture of their size by the last choice."""
        return sum(math.exp2(level) for level in self.levels) / math.exp2(self.last.level if self.last else 0.0)

    def following(self, last: Trial, coarsest: float = COARSEST) -> Aim:
        """The same, from a choice that held for another view or transfer function."""
        return replace(self, ways=(last.classification,), last=last, coarsest=coarsest)


@dataclass(frozen=True)
class Choice:
    """What was chosen.

    Attributes
    ----------
    trial : classification and step
    error : estimated, the residual of rays that end early included
    reason : for its way of classification, in words
    """

    trial: Trial
    error: float
    reason: str = ""


def make_aim(scene: Scene) -> Aim:
    """What a completed scene with a volume and `quality.max_error` asks for."""
    bound = scene.quality.max_error
    assert bound is not None, "no bound was asked for"
    both = all(is_preintegrated(volume, "pre-integrated") for volume in scene.volumes)
    ways: tuple[Classification, ...] = ("post", "pre-integrated") if both else ("post",)
    # Slabs are cut, and lie in one of several volumes, as wholes: opacity jumps at planes and faces.
    cut = len(scene.volumes) > 1 or bool(scene.clip.planes) or scene.clip.box is not None
    return Aim(bound, math.prod(scene.image.size), ways, cut or any(map(_is_steep, scene.volumes)), cut)


def _is_steep(volume: Volume) -> bool:
    """Whether its opacity or colour jumps, or changes faster than a few samples of a steep field can show."""
    if volume.transfer_2d or volume.interpolation == "nearest":
        return True
    transfer = transfer_function(volume)
    low, high = transfer.domain
    for values, results in (
        (transfer.opacity_values, transfer.opacities[:, None]),
        (transfer.colour_values, transfer.colours),
    ):
        changes = np.abs(np.diff(results, axis=0)).max(axis=1, initial=0.0)
        if np.any(changes * (high / 2 - low / 2) > STEEP * (values[1:] / 2 - values[:-1] / 2)):
            return True
    return False


def next_trial(pictures: Pictures, aim: Aim) -> Trial | None:
    """What to draw next, or None where enough is known to choose."""
    for way in aim.ways:  # the outer loop, since each has its bricks stored in its own way
        for level in aim.levels:
            if Trial(way, level) not in pictures:
                return Trial(way, level)
    errors = errors_of(pictures, aim.pixels, SAFETY)
    disputed = _disputed(pictures, aim)
    if disputed:
        return disputed
    best = min(aim.ways, key=lambda way: _wanted(errors[way], way, aim.target).cost)
    last = max(errors[best])
    holds = errors[best][last - aim.jumps] <= aim.target
    return None if holds or last >= FINEST else Trial(best, last + 1)


def choose(pictures: Pictures, aim: Aim) -> Choice:
    """The cheapest setting that is expected to hold the bound, or else the most accurate one."""
    found, errors = [], errors_of(pictures, aim.pixels, SAFETY)
    few = max(np.count_nonzero(picture.any(axis=-1)) for picture in pictures.values()) < FEW
    for way, curve in errors.items():
        wanted = _wanted(curve, way, aim.target).level
        level = math.ceil(wanted) if few or wanted < FIRST else math.ceil(4 * wanted) / 4
        level = min(max(curve), max(aim.coarsest, level))
        found.append(_expected(Trial(way, level), curve, aim))
    reached = [choice for choice in found if choice.error <= aim.bound]
    if not reached:
        return _with_reason(min(found, key=lambda one: one.error), found, aim)
    cheapest = _with_reason(min(reached, key=lambda choice: choice.trial.cost), found, aim)
    if aim.last and aim.last.cost <= STEADY * cheapest.trial.cost:
        kept = _expected(aim.last, errors[aim.last.classification], aim)
        return replace(kept, reason=cheapest.reason) if kept.error <= aim.bound else cheapest
    return cheapest


def _with_reason(choice: Choice, among: list[Choice], aim: Aim) -> Choice:
    """The choice, and why not the other way."""
    other = next((one for one in among if one.trial.classification != choice.trial.classification), None)
    if other is None:
        text = "as in the view before" if aim.last else "the only one for what is shown"
    elif other.error > aim.bound:
        text = (
            f"{other.trial.classification} does not hold it down to step {other.trial.step:.3g}, and promises no less"
        )
    else:
        ratio = other.trial.cost / choice.trial.cost
        text = f"{other.trial.classification} at step {other.trial.step:.3g} would cost {ratio:.2g} times as much"
    return replace(choice, reason=text)


def verified(pictures: Sequence[NDArray[Any]], aim: Aim) -> float:
    """The error of a picture in all of its pixels, by those of longer steps; the residual of early ends is included.

    Parameters
    ----------
    pictures : (h, w, 4), whole, of twice the step each: the last but two, the last but one, and the picture itself
    """
    first, before, finest = pictures
    last, earlier = float(apart(finest, before).max()), float(apart(before, first).max())
    return VERIFIED_SAFETY * (last if aim.is_cut else still_missing(last, earlier)) + aim.residual


def has_strayed(choice: Choice, calibrated: Choice, aim: Aim) -> bool:
    """Whether a choice was followed too far: the other way may be cheaper now, or hold where it does not."""
    unreached = choice.error > aim.bound and calibrated.error <= aim.bound
    return unreached or abs(choice.trial.level - calibrated.trial.level) > STRAY


def _expected(trial: Trial, curve: dict[int, float], aim: Aim) -> Choice:
    """A setting with the error that the errors of its way promise."""
    return Choice(trial, math.exp2(np.interp(trial.level, list(curve), logarithms(curve))) + aim.residual)


def _disputed(pictures: Pictures, aim: Aim) -> Trial | None:
    """The next picture of the coarser way, where two ways differ by more than both of them are said to lack."""
    levels = levels_of(pictures)
    if len(levels) < 2:
        return None
    lacking = sum(left_of(pictures, way, known, aim.pixels) for way, known in levels.items())
    one, other = (pictures[Trial(way, known[-1])] for way, known in levels.items())
    way, known = min(levels.items(), key=lambda item: item[1][-1])
    agree = largest(apart(one, other), aim.pixels) * (1 - SLOWEST) <= max(lacking, aim.target / SAFETY)
    return None if agree or known[-1] >= FINEST else Trial(way, known[-1] + 1)


def _wanted(curve: dict[int, float], way: Classification, target: float) -> Trial:
    """Where the errors of a way meet the target: linear in the logarithms, and extended beyond the last of them."""
    levels, logs = list(curve), logarithms(curve)
    over = np.flatnonzero(logs > math.log2(target)).tolist()
    if not over:
        return Trial(way, levels[0])
    last = over[-1]
    slope = float(logs[min(last, len(levels) - 2)] - logs[min(last, len(levels) - 2) + 1])
    if last == len(levels) - 1:
        slope = min(max(slope, -math.log2(SLOWEST)), -math.log2(FASTEST))
    return Trial(way, levels[last] + float(logs[last] - math.log2(target)) / slope)
