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

from clusterviz.data.source import Index, as_index

Read = Callable[[Index, Index], NDArray[Any]]
WEIGHTS = (-0.125, 0.25, 0.75)


def coarser(shape_zyx: Index) -> Index:
    """Return the samples of the next coarser level."""
    return as_index((side + 1) // 2 for side in shape_zyx)


def low_pass(read: Read, shape_zyx: Index, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
    """Return a box of samples of the next coarser level.

    Parameters
    ----------
    begin_zyx, end_zyx : the half-open box of samples of the coarser one

    Returns
    -------
    samples : of the type read, rounded and clamped to its range; NaN where a weighted sample is not finite
    """
    lows = [max(0, 2 * b - 2) for b in begin_zyx]
    highs = [min(n, 2 * e + 1) for e, n in zip(end_zyx, shape_zyx, strict=True)]
    samples = read(as_index(lows), as_index(highs))
    mirrored = [
        _mirrored(np.arange(2 * b - 2, 2 * e + 1), n) - low
        for b, e, n, low in zip(begin_zyx, end_zyx, shape_zyx, lows, strict=True)
    ]
    z, y, x = mirrored
    kind = np.float32 if samples.dtype.kind in "iu" and samples.itemsize == 1 else np.float64  # in which sums are exact
    result = np.empty(np.subtract(end_zyx, begin_zyx), samples.dtype)
    planes: dict[int, NDArray[Any]] = {}
    # Plane by plane, so that sums stay in the cache.
    for i, target in enumerate(result):
        wanted = z[2 * i : 2 * i + 5].tolist()
        planes = {
            n: planes[n] if n in planes else _filtered(_filtered(samples[n], y, 0, kind), x, 1, kind) for n in wanted
        }
        with np.errstate(invalid="ignore", over="ignore"):
            target[...] = _rounded(_weighted([planes[n] for n in wanted]), samples.dtype)
    return result


def _mirrored(indices: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return indices of samples, mirrored at the first and the last one."""
    period = max(1, 2 * count - 2)
    indices = indices % period
    return np.minimum(indices, period - indices) if count > 1 else indices


def _filtered(plane: NDArray[Any], indices: NDArray[np.int64], axis: int, kind: Any) -> NDArray[Any]:
    """Return the low-pass along an axis: of five samples with these indices, of those two further on, and so on."""
    # Every second sample, so that sums run over contiguous memory.
    even, odd = (plane.take(indices[n::2], axis).astype(kind, copy=False) for n in (0, 1))
    count = len(indices) // 2 - 1
    spans = [(even, 0), (odd, 0), (even, 1), (odd, 1), (even, 2)]
    return _weighted([part[n : n + count] if axis == 0 else part[:, n : n + count] for part, n in spans])


def _weighted(parts: list[Any]) -> NDArray[Any]:
    outer, inner, middle = WEIGHTS
    total: NDArray[Any] = outer * (parts[0] + parts[4]) + inner * (parts[1] + parts[3]) + middle * parts[2]
    return total


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
    kind = np.float32 if fine.dtype.kind in "iu" and fine.itemsize <= 2 else np.float64  # in which means are exact
    largest, behind, ahead = 0.0, np.empty(0), _finer(coarse[0].astype(kind), fine.shape[1:])
    for z, plane in enumerate(fine):
        if z % 2 == 0:
            behind, following = ahead, min(z // 2 + 1, len(coarse) - 1)
            ahead = _finer(coarse[following].astype(kind), fine.shape[1:])
        found = behind if z % 2 == 0 else _mean(behind, ahead)
        largest = max(largest, largest_difference(plane, found))
    return largest


def _finer(plane: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return a plane interpolated to twice the resolution, of a given shape."""
    for count in shape:
        finer = np.empty((count, plane.shape[1]), plane.dtype)
        finer[0::2] = plane[: (count + 1) // 2]
        following = plane[np.minimum(np.arange(count // 2) + 1, len(plane) - 1)]
        finer[1::2] = _mean(plane[: count // 2], following)
        plane = np.ascontiguousarray(finer.T)
    return plane


def _mean(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    with np.errstate(invalid="ignore"):
        mean: NDArray[Any] = a * 0.5 + b * 0.5
    return mean


def largest_difference(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Return the largest difference between finite samples; inf where only one of both is finite."""
    kind = np.result_type(a, b, np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        away = np.abs(a.astype(kind) - b.astype(kind))
    largest = float(away.max())
    if np.isfinite(largest):
        return largest
    if not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return float("inf")
    return float(away[np.isfinite(away)].max(initial=0.0))


def is_within(samples: NDArray[Any], others: NDArray[Any], error: float) -> bool:
    """Return whether samples differ by at most an error, and those that are not finite by no bit."""
    bits = f"u{samples.itemsize}"
    differs = samples.view(bits) != others.view(bits)
    if not differs.any():
        return True
    if error == 0 or (samples.dtype.kind != "f" and samples.itemsize == 8):
        return False
    if samples.dtype.kind != "f":
        return largest_difference(samples, others) <= error
    a, b = samples[differs].astype(np.float64), others[differs].astype(np.float64)
    # Less, since a difference that is rounded may have been greater.
    return bool(np.isfinite(a).all() and np.isfinite(b).all() and np.abs(a - b).max() < error)
