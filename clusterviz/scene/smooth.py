"""Curves through key frames that neither overshoot nor loop: for numbers, and for points in space.

References
----------
F. N. Fritsch, J. Butland: A method for constructing local monotone piecewise cubic interpolants, SIAM Journal on
Scientific and Statistical Computing 5(2), 1984.
C. Yuksel, S. Schaefer, J. Keyser: On the parameterization of Catmull-Rom curves, SPM 2009: with knots by the root of
the distance (centripetal) a segment has neither cusps nor loops.
P. Barry, R. Goldman: A recursive evaluation algorithm for a class of Catmull-Rom splines, SIGGRAPH 1988.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def monotone(times: Floats, values: Floats, time: float) -> Floats:
    """Numbers at a time, each monotone between two keys, with a continuous rate of change.

    Parameters
    ----------
    times : float64 (n,), ascending, all different
    values : float64 (n, k)
    time : before the first key, and after the last one, the curve is constant

    Returns
    -------
    float64 (k,)
    """
    if len(times) == 1 or time <= times[0]:
        return np.array(values[0])
    if time >= times[-1]:
        return np.array(values[-1])
    steps = np.diff(times)
    rates = np.diff(values, axis=0) / steps[:, None]
    i = int(np.searchsorted(times, time, side="right")) - 1
    low, high = _slope(rates, steps, i), _slope(rates, steps, i + 1)
    u = (time - times[i]) / steps[i]
    along = values[i] + (values[i + 1] - values[i]) * (u * u * (3 - 2 * u))
    curve: Floats = along + steps[i] * (u * (1 - u)) * ((1 - u) * low - u * high)
    # A rounding error must not leave the range of the two keys.
    return np.clip(curve, np.minimum(values[i], values[i + 1]), np.maximum(values[i], values[i + 1]))


def _slope(rates: Floats, steps: Floats, key: int) -> Floats:
    """The rate of change at a key: a weighted harmonic mean of those beside it, 0 where they differ in sign."""
    if key in (0, len(rates)):
        return np.array(rates[min(key, len(rates) - 1)])
    before, after, short, long = rates[key - 1], rates[key], steps[key - 1], steps[key]
    first, second = 2 * long + short, long + 2 * short
    same = before * after > 0
    safe_before, safe_after = np.where(same, before, 1.0), np.where(same, after, 1.0)
    return np.where(same, (first + second) / (first / safe_before + second / safe_after), 0.0)


def centripetal(times: Floats, points: Floats, time: float) -> Floats:
    """A point of the centripetal Catmull-Rom curve; its speed changes smoothly from key to key.

    Parameters
    ----------
    times : float64 (n,), ascending, all different
    points : float64 (n, 3); two that follow each other may be the same: there the curve rests
    time : before the first key, and after the last one, the curve rests

    Returns
    -------
    float64 (3,)
    """
    scale = float(np.abs(points).max()) or 1.0
    knots = np.concatenate([[0.0], np.cumsum(np.sqrt(np.linalg.norm(np.diff(points / scale, axis=0), axis=1)))])
    knot = float(monotone(times, knots[:, None], time)[0])
    i = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, max(0, len(times) - 2)))
    if len(times) == 1 or knots[i + 1] == knots[i]:
        return np.array(points[i])
    before, b, c, after = i - 1, points[i], points[i + 1], i + 2
    length = knots[i + 1] - knots[i]
    # Beyond the ends, and where the curve rests, a point is mirrored.
    has_before = before >= 0 and knots[before] < knots[i]
    has_after = after < len(times) and knots[after] > knots[i + 1]
    a, t0 = (points[before], knots[before]) if has_before else (2 * b - c, knots[i] - length)
    d, t3 = (points[after], knots[after]) if has_after else (2 * c - b, knots[i + 1] + length)
    return _barry_goldman((a, b, c, d), (t0, knots[i], knots[i + 1], t3), knot)


def _barry_goldman(points: tuple[Floats, ...], knots: tuple[float, ...], t: float) -> Floats:
    """The pyramid of linear interpolations: between two knots the curve, at the two inner ones its points."""
    level = list(points)
    for width, spans in ((1, 3), (2, 2)):
        level = [
            _between(level[k], level[k + 1], knots[k], knots[k + width], t)
            for k in range(spans)
        ]  # fmt: skip
    return _between(level[0], level[1], knots[1], knots[2], t)


def _between(a: Floats, b: Floats, begin: float, end: float, t: float) -> Floats:
    share = (t - begin) / (end - begin)
    return (1 - share) * a + share * b
