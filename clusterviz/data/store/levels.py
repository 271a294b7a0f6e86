"""Levels of a volume: the low-pass of the linear spline wavelet, and how far a level is from the finest one.

Sample i of a level lies at sample 2i of the next finer one. The low-pass has the weights −1, 2, 6, 2, −1 eighths along
each axis, with samples mirrored beyond the ends: it keeps means, and linear functions away from the ends.

A level stands for the function that is linear between its samples along each axis, and constant beyond the last one.
Such a function on a coarser level is one on a finer level, too. So the difference between two neighbouring levels is
greatest at a sample of the finer one, and differences over several levels add up to a bound.

References
----------
A. Cohen, I. Daubechies, J.-C. Feauveau: Biorthogonal bases of compactly supported wavelets, Comm. Pure Appl. Math.
45(5), 1992: the wavelet (2, 2).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index

Read = Callable[[Index, Index], NDArray[Any]]
WEIGHTS = (-0.125, 0.25, 0.75)


def coarser(shape_zyx: Index) -> Index:
    """Return the samples of the next coarser level."""
    z, y, x = ((side + 1) // 2 for side in shape_zyx)
    return z, y, x


def low_pass(read: Read, shape_zyx: Index, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
    """Return a box of samples of the next coarser level.

    Parameters
    ----------
    read : returns a box of samples of a level
    shape_zyx : of this level
    begin_zyx, end_zyx : the half-open box of samples of the coarser one

    Returns
    -------
    samples : of the type read, rounded and clamped to its range; NaN where a weighted sample is not finite
    """
    sides = list(zip(begin_zyx, end_zyx, shape_zyx, strict=True))
    lows, highs = zip(*((max(0, 2 * b - 2), min(n, 2 * e + 1)) for b, e, n in sides), strict=True)
    samples = read(lows, highs)
    exact = samples.dtype.kind in "iu" and samples.itemsize == 1
    found: NDArray[Any] = samples.astype(np.float32 if exact else np.float64)
    for axis, (begin, end, _) in enumerate(sides):
        wide = 2 * (end - begin) + 3
        before = lows[axis] - (2 * begin - 2)
        padding = [(0, 0)] * 3
        padding[axis] = before, wide - before - found.shape[axis]
        found = np.pad(found, padding, mode="reflect") if found.shape[axis] > 1 else np.repeat(found, wide, axis)
        parts: list[Any] = [np.moveaxis(found, axis, 0)[n : wide - 4 + n : 2] for n in range(5)]
        with np.errstate(invalid="ignore", over="ignore"):
            total = WEIGHTS[0] * (parts[0] + parts[4]) + WEIGHTS[1] * (parts[1] + parts[3]) + WEIGHTS[2] * parts[2]
        found = np.moveaxis(total, 0, axis)
    return np.ascontiguousarray(_rounded(found, samples.dtype))


def _rounded(values: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    with np.errstate(over="ignore"):
        if dtype.kind == "f":
            return values.astype(dtype)
        low, high = (float(limit) for limit in (np.iinfo(dtype).min, np.iinfo(dtype).max))
        if dtype.itemsize == 8:
            high = float(np.nextafter(high, 0))
        rounded: NDArray[Any] = np.clip(np.rint(values), low, high).astype(dtype)
    return rounded


def difference(fine: NDArray[Any], coarse: NDArray[Any]) -> float:
    """Return the largest difference between samples and the interpolated samples of the next coarser level.

    Parameters
    ----------
    fine : (z, y, x), begins at an even index along each axis
    coarse : the samples of the coarser level from the same position, up to the first at or beyond the last one of
        `fine`, or the last one that there is

    Returns
    -------
    largest : inf where only one of both is finite
    """
    found = coarse.astype(np.float64)
    for axis, count in enumerate(fine.shape):
        lines = np.moveaxis(found, axis, 0)
        following = lines[np.minimum(np.arange(count // 2) + 1, len(lines) - 1)]
        finer = np.empty((count, *lines.shape[1:]))
        finer[0::2] = lines[: (count + 1) // 2]
        with np.errstate(invalid="ignore", over="ignore"):
            finer[1::2] = 0.5 * lines[: count // 2] + 0.5 * following
        found = np.moveaxis(finer, 0, axis)
    return largest_difference(fine, found)


def largest_difference(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Return the largest difference between finite samples; inf where only one of both is finite."""
    with np.errstate(invalid="ignore", over="ignore"):
        away = np.abs(a.astype(np.float64) - b.astype(np.float64))
    if not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return float("inf")
    return float(away[np.isfinite(away)].max(initial=0.0))
