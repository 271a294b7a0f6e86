"""Spline interpolation of key frames: monotone cubics for numbers, centripetal Catmull-Rom curves for positions.

References
----------
F. N. Fritsch, J. Butland: A method for constructing local monotone piecewise cubic interpolants, SIAM Journal on
Scientific and Statistical Computing 5(2), 1984.
C. Yuksel, S. Schaefer, J. Keyser: On the parameterization of Catmull-Rom curves, SPM 2009: centripetal knots give
segments without cusps and loops.
P. Barry, R. Goldman: A recursive evaluation algorithm for a class of Catmull-Rom splines, SIGGRAPH 1988.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def monotone(times: Floats, values: Floats, time: float) -> Floats:
    """Interpolate numbers, monotonically between two key frames and with a continuous derivative.

    Parameters
    ----------
    times : float64 (n,), strictly ascending
    values : float64 (n, k)
    time : the curve is constant before the first and after the last key frame

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
    # Rounding must not leave the range of the two key frames.
    return np.clip(curve, np.minimum(values[i], values[i + 1]), np.maximum(values[i], values[i + 1]))


def _slope(rates: Floats, steps: Floats, key: int) -> Floats:
    """Return the derivative at a key frame: a weighted harmonic mean of both slopes, 0 if their signs differ."""
    if key in (0, len(rates)):
        return np.array(rates[min(key, len(rates) - 1)])
    before, after, short, long = rates[key - 1], rates[key], steps[key - 1], steps[key]
    first, second = 2 * long + short, long + 2 * short
    same = before * after > 0
    safe_before, safe_after = np.where(same, before, 1.0), np.where(same, after, 1.0)
    return np.where(same, (first + second) / (first / safe_before + second / safe_after), 0.0)


def centripetal(times: Floats, points: Floats, time: float) -> Floats:
    """Interpolate positions along a centripetal Catmull-Rom curve with continuous speed.

    Parameters
    ----------
    times : float64 (n,), strictly ascending
    points : float64 (n, 3); the curve is constant between equal consecutive points
    time : the curve is constant before the first and after the last key frame

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
    # Beyond the ends, and beside a constant part, a neighbour is mirrored.
    has_before = before >= 0 and knots[before] < knots[i]
    has_after = after < len(times) and knots[after] > knots[i + 1]
    a, t0 = (points[before], knots[before]) if has_before else (2 * b - c, knots[i] - length)
    d, t3 = (points[after], knots[after]) if has_after else (2 * c - b, knots[i + 1] + length)
    return _barry_goldman((a, b, c, d), (t0, knots[i], knots[i + 1], t3), knot)


def _barry_goldman(points: tuple[Floats, ...], knots: tuple[float, ...], t: float) -> Floats:
    """Evaluate a Catmull-Rom segment by repeated linear interpolation."""
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
