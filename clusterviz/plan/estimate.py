"""How far small pictures of a scene are from the picture without error, from how far they are from each other.

The finest of the pictures stands for the truth. What it lacks itself follows from how fast the pictures before it came
nearer, and what the rays that were not drawn may add from how steep the tail of the errors is. The error of a picture
is the largest of any pixel and channel, of a full scale of 1.

References
----------
L. F. Richardson, Phil. Trans. R. Soc. A 210, 1911 (what is left, from the last change). I. Weissman, J. Am. Stat.
Assoc. 73, 1978 (largest values from the k largest of a sample).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.blend_mode import Classification

WEIGHTS: dict[Classification, float] = {"post": 1.0, "pre-integrated": 1.8}
"""Time of a sample, measured (docs/measurements/accuracy.md)."""
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


def levels_of(pictures: Pictures) -> dict[Classification, list[int]]:
    """The levels that there are of each way, ascending."""
    levels: dict[Classification, list[int]] = {}
    for way, level in sorted(pictures):
        levels.setdefault(way, []).append(int(level))
    return levels


def errors_of(pictures: Pictures, pixels: int, safety: float) -> dict[Classification, dict[int, float]]:
    """Estimated errors by way and level, ascending; none is smaller than that of a finer level.

    Each way's finest picture may stand for the truth; the one that promises the smaller error does.
    """
    levels = levels_of(pictures)
    truths = [(left_of(pictures, way, known, pixels), pictures[Trial(way, known[-1])]) for way, known in levels.items()]
    errors: dict[Classification, dict[int, float]] = {}
    for way, known in levels.items():
        drawn = [pictures[Trial(way, level)] for level in known]
        rows = [min(left + largest(apart(one, truth), pixels) for left, truth in truths) for one in drawn]
        monotone = np.maximum.accumulate(rows[::-1])[::-1] * safety
        errors[way] = dict(zip(known, monotone.tolist(), strict=True))
    return errors


def left_of(pictures: Pictures, way: Classification, levels: list[int], pixels: int) -> float:
    """What the finest picture of a way lacks: each halving is taken to leave the share that the last one left."""
    finest, before, first = (pictures[Trial(way, level)] for level in levels[:-4:-1])
    last, earlier = largest(apart(finest, before), pixels), largest(apart(before, first), pixels)
    return still_missing(last, earlier)


def still_missing(last: float, earlier: float) -> float:
    """What is left after two halvings of the step, the last of which changed this much."""
    share = min(max(last / max(earlier, 1e-30), FASTEST), SLOWEST)
    return last * share / (1 - share)


def apart(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    """The largest difference of each pixel's channels, (h, w)."""
    difference: NDArray[np.float64] = np.abs(a.astype(np.float64) - b).max(axis=-1)
    return difference


def logarithms(curve: dict[int, float]) -> NDArray[np.float64]:
    """Base 2; no error at all counts as a very small one."""
    return np.asarray(np.log2(np.maximum(list(curve.values()), 1e-30)))
