"""Estimated errors of small pictures of a scene, from the differences between them.

The finest picture serves as the reference. Its own error follows from the rate at which the coarser pictures converge,
and the error in pixels that were not drawn from the tail of the distribution of errors. The error of a picture is the
largest of any pixel and channel, with a full scale of 1.

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
"""Number of largest errors to which the tail is fitted, and the largest factor that it may add."""
SLOWEST, FASTEST = 1 / 2, 1 / 4
"""Factor of the error when the step is halved: 1/2 at jumps of the opacity, 1/4 without jumps."""


class Trial(NamedTuple):
    """Settings of a small picture: its classification, and the level of its step."""

    classification: Classification
    level: float

    @property
    def step(self) -> float:
        """Length of a slab in voxels."""
        return math.exp2(-self.level)

    @property
    def cost(self) -> float:
        """Cost relative to post-classification at a step of one voxel."""
        return WEIGHTS[self.classification] * math.exp2(self.level)


Pictures = Mapping[Trial, NDArray[Any]]
"""Pictures (h, w, 4), all of one size."""


def largest(errors: NDArray[Any], pixels: int) -> float:
    """Estimate the largest error of a picture from a sample of its pixels.

    `errors`: errors of the sampled pixels, any shape. `pixels`: number of pixels of the whole picture. Returns
    Weissman's estimate from the TAIL largest of the sample, between once and MOST_TAIL times the largest.
    """
    top = np.sort(errors.ravel().astype(np.float64))[::-1][: TAIL + 1]
    most = float(top[0])
    if pixels <= errors.size or len(top) <= TAIL or top[-1] <= 0:
        return most
    index = float(np.log(top[:-1] / top[-1]).mean())
    beyond = float(top[-1] * (TAIL * pixels / errors.size) ** index)
    return min(max(most, beyond), MOST_TAIL * most)


def levels_of(pictures: Pictures) -> dict[Classification, list[int]]:
    """Return the levels of the pictures by classification, ascending."""
    levels: dict[Classification, list[int]] = {}
    for classification, level in sorted(pictures):
        levels.setdefault(classification, []).append(int(level))
    return levels


def errors_of(pictures: Pictures, pixels: int, safety: float) -> dict[Classification, dict[int, float]]:
    """Estimate errors by classification and level, ascending; none is smaller than that of a finer level.

    The reference is the finest picture of the classification with the smaller estimated error.
    """
    levels = levels_of(pictures)
    truths = [
        (left_of(pictures, classification, known, pixels), pictures[Trial(classification, known[-1])])
        for classification, known in levels.items()
    ]
    errors: dict[Classification, dict[int, float]] = {}
    for classification, known in levels.items():
        drawn = [pictures[Trial(classification, level)] for level in known]
        rows = [min(left + largest(difference(one, truth), pixels) for left, truth in truths) for one in drawn]
        monotone = np.maximum.accumulate(rows[::-1])[::-1] * safety
        errors[classification] = dict(zip(known, monotone.tolist(), strict=True))
    return errors


def left_of(pictures: Pictures, classification: Classification, levels: list[int], pixels: int) -> float:
    """Estimate the error of a classification's finest picture, if further halvings converge at the last rate."""
    finest, before, first = (pictures[Trial(classification, level)] for level in levels[:-4:-1])
    last, earlier = largest(difference(finest, before), pixels), largest(difference(before, first), pixels)
    return still_missing(last, earlier)


def still_missing(last: float, earlier: float) -> float:
    """Estimate the error left after two halvings of the step.

    `last`, `earlier`: change by the last halving, and by the one before.
    """
    share = min(max(last / max(earlier, 1e-30), FASTEST), SLOWEST)
    return last * share / (1 - share)


def difference(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    """Return the largest difference of each pixel's channels, float64 (h, w)."""
    difference: NDArray[np.float64] = np.abs(a.astype(np.float64) - b).max(axis=-1)
    return difference


def logarithms(curve: dict[int, float]) -> NDArray[np.float64]:
    """Return logarithms to base 2 of errors; an error of 0 counts as a very small one."""
    return np.asarray(np.log2(np.maximum(list(curve.values()), 1e-30)))
