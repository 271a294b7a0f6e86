"""Which settings hold a bound on the error at least cost: `quality.max_error`, decided from small pictures.

What a step costs in accuracy depends on the field, the transfer function and the view, and no bound from slopes alone
is within an order of magnitude of the truth. So the scene is drawn with few rays at steps of 2, 1, ½, … voxels, until
a step is found that holds, by the errors that `estimate.py` finds in these pictures. Both ways of classification go to
the same picture: only the one that promises to be cheaper is made finer, unless they contradict each other. From frame
to frame a choice is followed: of the way that was chosen, pictures around the last step tell whether it still holds.

An eighth of the bound is for rays that end early (what is behind them adds no more than the residual), the rest for the
step. docs/accuracy.md says how often the choice was right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

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
)
from clusterviz.plan.look import Classification, is_preintegrated
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.values import Quality, Scene, Volume

COARSEST, FINEST = -1, 6
"""Levels: a step is 2^-level voxels."""
FIRST = 1
"""Pictures down to this level are made in any case: coarse ones may agree on what they all miss."""
TERMINATION = 1 / 8
"""Share of the bound for rays that end early."""
SAFETY, JUMPS = 1.5, 2.0
"""On all estimates; and once more where the opacity jumps, and single pixels are far worse than all others. There, too,
nothing is believed of a picture before a finer one was drawn."""
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
    jumps : whether the opacity jumps
    last : the choice of the frame before, which is followed; None where there is none
    coarsest : level of the longest step that may be chosen
    """

    bound: float
    pixels: int
    ways: tuple[Classification, ...]
    jumps: bool = False
    last: Trial | None = None
    coarsest: float = COARSEST

    @property
    def safety(self) -> float:
        """By which estimates are multiplied."""
        return SAFETY * JUMPS if self.jumps else SAFETY

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
    # Several volumes are classified at midpoints.
    both = len(scene.volumes) == 1 and is_preintegrated(scene.volumes[0], "pre-integrated")
    ways: tuple[Classification, ...] = ("post", "pre-integrated") if both else ("post",)
    return Aim(bound, math.prod(scene.image.size), ways, any(map(_jumps, scene.volumes)))


def _jumps(volume: Volume) -> bool:
    """Whether its opacity jumps."""
    transfer = transfer_function(volume)
    jumps = np.diff(transfer.opacities)[np.diff(transfer.opacity_values) == 0]
    return bool(np.any(jumps != 0))


def classification_of(quality: Quality) -> Classification:
    """What bricks must be read for: both ways, where the choice is open."""
    return quality.classification if quality.max_error is None else "pre-integrated"


def next_trial(pictures: Pictures, aim: Aim) -> Trial | None:
    """What to draw next, or None where enough is known to choose."""
    for way in aim.ways:  # the outer loop, since each has its bricks stored in its own way
        for level in aim.levels:
            if Trial(way, level) not in pictures:
                return Trial(way, level)
    errors = errors_of(pictures, aim.pixels, aim.safety)
    disputed = _disputed(pictures, aim)
    if disputed:
        return disputed
    best = min(aim.ways, key=lambda way: _wanted(errors[way], way, aim.target).cost)
    last = max(errors[best])
    holds = errors[best][last - aim.jumps] <= aim.target
    return None if holds or last >= FINEST else Trial(best, last + 1)


def choose(pictures: Pictures, aim: Aim) -> Choice:
    """The cheapest setting that is expected to hold the bound, or else the most accurate one."""
    found, errors = [], errors_of(pictures, aim.pixels, aim.safety)
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
    agree = largest(apart(one, other), aim.pixels) * (1 - SLOWEST) <= max(lacking, aim.target / aim.safety)
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
