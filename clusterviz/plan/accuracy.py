"""Which settings hold a bound on the error at least cost: `quality.max_error`, decided from small pictures.

What a step costs in accuracy depends on the field, the transfer function and the view, and no bound from slopes alone
is within an order of magnitude of the truth. So the scene is drawn with few rays at steps of 2, 1, ½, … voxels, until
a step is found that holds. The finest of these pictures stands for the truth. What it lacks itself follows from how
fast the pictures before it came nearer, and what the rays that were not drawn may add from how steep the tail of the
errors is. Both ways of classification go to the same picture: only the one that promises to be cheaper is made finer.

The error of a picture is the largest of any pixel and channel, of a full scale of 1. An eighth of the bound is for rays
that end early (what is behind them adds no more than the residual), the rest for the step.

References
----------
L. F. Richardson, Phil. Trans. R. Soc. A 210, 1911 (what is left, from the last change). I. Weissman, J. Am. Stat.
Assoc. 73, 1978 (largest values from the k largest of a sample). docs/accuracy.md says how often it was right.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.look import Classification, is_preintegrated
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.values import Quality, Scene, Volume

COARSEST, FINEST = -1, 6
"""Levels: a step is 2^-level voxels."""
FIRST = 1
"""Pictures down to this level are made in any case: coarse ones may agree on what they all miss."""
WEIGHTS: dict[Classification, float] = {"post": 1.0, "pre-integrated": 1.8}
"""Time of a sample, measured (docs/accuracy.md)."""
TERMINATION = 1 / 8
"""Share of the bound for rays that end early."""
SAFETY, JUMPS = 1.5, 2.0
"""On all estimates; and once more where the opacity jumps, and single pixels are far worse than all others. There, too,
nothing is believed of a picture before a finer one was drawn."""
TAIL, MOST_TAIL = 16, 4.0
"""How many of the largest errors tell how the tail goes on, and what it may add at most."""
SLOWEST, FASTEST = 1 / 2, 1 / 4
"""What of an error half the step leaves: 1/2 at jumps of the opacity, 1/4 where nothing jumps."""


class Trial(NamedTuple):
    """A small picture that is drawn."""

    classification: Classification
    level: float

    @property
    def step(self) -> float:
        """In voxels."""
        return math.exp2(-self.level)

    @property
    def cost(self) -> float:
        """Relative to midpoints at a step of one voxel."""
        return WEIGHTS[self.classification] * math.exp2(self.level)


Pictures = Mapping[Trial, NDArray[Any]]
"""(h, w, 4) each, of one size."""


@dataclass(frozen=True)
class Aim:
    """What is asked for.

    Attributes
    ----------
    bound : on the error
    pixels : of the whole picture
    ways : of classification, between which there is a choice
    jumps : whether the opacity jumps
    """

    bound: float
    pixels: int
    ways: tuple[Classification, ...]
    jumps: bool = False

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


@dataclass(frozen=True)
class Choice:
    """What was chosen.

    Attributes
    ----------
    trial : classification and step
    error : estimated, the residual of rays that end early included
    """

    trial: Trial
    error: float


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


def largest(errors: NDArray[Any], pixels: int) -> float:
    """The largest error of a picture, from those of a sample of its pixels.

    Parameters
    ----------
    errors : of any shape, one a pixel
    pixels : of the whole picture

    Returns
    -------
    error : Weissman's estimate from the TAIL largest of the sample, between once and MOST_TAIL times the largest
    """
    top = np.sort(errors.ravel().astype(np.float64))[::-1][: TAIL + 1]
    most = float(top[0])
    if pixels <= errors.size or len(top) <= TAIL or top[-1] <= 0:
        return most
    index = float(np.log(top[:-1] / top[-1]).mean())
    beyond = float(top[-1] * (TAIL * pixels / errors.size) ** index)
    return min(max(most, beyond), MOST_TAIL * most)


def next_trial(pictures: Pictures, aim: Aim) -> Trial | None:
    """What to draw next, or None where enough is known to choose."""
    for way in aim.ways:  # the outer loop, since each has its bricks stored in its own way
        for level in range(COARSEST, FIRST + 1):
            if Trial(way, level) not in pictures:
                return Trial(way, level)
    errors = _errors(pictures, aim)
    best = min(aim.ways, key=lambda way: _wanted(errors[way], way, aim.target).cost)
    last = max(errors[best])
    holds = errors[best][last - aim.jumps] <= aim.target
    return None if holds or last >= FINEST else Trial(best, last + 1)


def choose(pictures: Pictures, aim: Aim) -> Choice:
    """The cheapest setting that is expected to hold the bound, or else the most accurate one."""
    found = []
    for way, curve in _errors(pictures, aim).items():
        wanted = _wanted(curve, way, aim.target).level
        level = min(max(curve), max(COARSEST, math.ceil(4 * wanted) / 4))
        error = math.exp2(np.interp(level, list(curve), _logs(curve)))
        found.append(Choice(Trial(way, level), error + aim.residual))
    reached = [choice for choice in found if choice.error <= aim.bound]
    return min(reached, key=lambda choice: choice.trial.cost) if reached else min(found, key=lambda one: one.error)


def _errors(pictures: Pictures, aim: Aim) -> dict[Classification, dict[int, float]]:
    """Estimated errors by way and level, ascending; none is smaller than that of a finer level."""
    levels: dict[Classification, list[int]] = {}
    for way, level in sorted(pictures):
        levels.setdefault(way, []).append(int(level))
    left = {way: _left(pictures, way, known, aim.pixels) for way, known in levels.items()}
    truest = min(left, key=lambda way: left[way])
    truth = pictures[Trial(truest, levels[truest][-1])]
    errors: dict[Classification, dict[int, float]] = {}
    for way, known in levels.items():
        rows = [left[truest] + largest(_apart(pictures[Trial(way, k)], truth), aim.pixels) for k in known]
        monotone = np.maximum.accumulate(rows[::-1])[::-1] * aim.safety
        errors[way] = dict(zip(known, monotone.tolist(), strict=True))
    return errors


def _left(pictures: Pictures, way: Classification, levels: list[int], pixels: int) -> float:
    """What the finest picture of a way lacks: each halving is taken to leave the share that the last one left."""
    finest, before, first = (pictures[Trial(way, level)] for level in levels[:-4:-1])
    last, earlier = largest(_apart(finest, before), pixels), largest(_apart(before, first), pixels)
    share = min(max(last / max(earlier, 1e-30), FASTEST), SLOWEST)
    return last * share / (1 - share)


def _apart(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    """The largest difference of each pixel's channels, (h, w)."""
    apart: NDArray[np.float64] = np.abs(a.astype(np.float64) - b).max(axis=-1)
    return apart


def _wanted(curve: dict[int, float], way: Classification, target: float) -> Trial:
    """Where the errors of a way meet the target: linear in the logarithms, and extended beyond the last of them."""
    levels, logs = list(curve), _logs(curve)
    over = np.flatnonzero(logs > math.log2(target)).tolist()
    if not over:
        return Trial(way, levels[0])
    last = over[-1]
    slope = float(logs[min(last, len(levels) - 2)] - logs[min(last, len(levels) - 2) + 1])
    if last == len(levels) - 1:
        slope = min(max(slope, -math.log2(SLOWEST)), -math.log2(FASTEST))
    return Trial(way, levels[last] + float(logs[last] - math.log2(target)) / slope)


def _logs(curve: dict[int, float]) -> NDArray[np.float64]:
    """Base 2; no error at all counts as a very small one."""
    return np.asarray(np.log2(np.maximum(list(curve.values()), 1e-30)))
