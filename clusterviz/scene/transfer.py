"""Transfer functions: colour and opacity of a scalar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Number = TypeVar("Number", bound=np.number[Any])
OPAQUE = 1.0 - 2.0**-24
"""Largest opacity, so that extinction is finite; less than half a float32 step from 1."""


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """Piecewise-linear colour and opacity of a scalar, constant beyond the first and last control point.

    A repeated value is a step; at exactly that scalar the later control point applies. NaN has colour 0 and opacity 0.

    Attributes
    ----------
    colour_values : float64 (n,), ascending, n >= 1
    colours : float64 (n, 3), straight RGB in [0, 1]
    opacity_values : float64 (m,), ascending, m >= 1
    opacities : float64 (m,), over `unit_distance`, in [0, 1]
    unit_distance : world units, more than 0
    domain : (low, high), low < high: `clim` of the volume, or a range around it if both ends are equal
    """

    colour_values: Floats
    colours: Floats
    opacity_values: Floats
    opacities: Floats
    unit_distance: float
    domain: tuple[float, float]

    def __post_init__(self) -> None:
        colour_values, colours = without_hidden_points(self.colour_values, self.colours)
        opacity_values, opacities = without_hidden_points(self.opacity_values, self.opacities)
        arrays = {
            "colour_values": colour_values,
            "colours": colours,
            "opacity_values": opacity_values,
            "opacities": opacities,
        }
        for name, array in arrays.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def colour(self, s: ArrayLike) -> Floats:
        """Return straight RGB, float64 (…, 3), of scalars (…)."""
        return interpolate(s, self.colour_values, self.colours)

    def opacity(self, s: ArrayLike) -> Floats:
        """Return opacity over the unit distance, float64 (…), of scalars (…)."""
        return interpolate(s, self.opacity_values, self.opacities[:, None])[..., 0]

    def extinction(self, s: ArrayLike) -> Floats:
        """Return extinction κ = −ln(1 − α) / unit distance, float64 (…), per world unit; α is at most 1 − 2⁻²⁴."""
        return -np.log1p(-np.minimum(self.opacity(s), OPAQUE)) / self.unit_distance

    def is_transparent(self, low: ArrayLike, high: ArrayLike) -> NDArray[np.bool_]:
        """Return whether opacity is exactly 0 for all scalars of closed intervals.

        Parameters
        ----------
        low, high : (…), the ends of the intervals; an empty interval (low > high) is transparent

        Returns
        -------
        transparent : bool (…); False where an end is NaN
        """
        low, high = np.broadcast_arrays(np.asarray(low, np.float64), np.asarray(high, np.float64))
        visible = np.concatenate([[0], np.cumsum(self.opacities != 0)])
        begin = np.searchsorted(self.opacity_values, low, side="right")
        end = np.searchsorted(self.opacity_values, high, side="right")
        hidden_inside = visible[np.maximum(begin, end)] == visible[begin]
        hidden = hidden_inside & (self.opacity(low) == 0) & (self.opacity(high) == 0)
        known = ~(np.isnan(low) | np.isnan(high))
        return np.asarray(known & (hidden | (low > high)))


def interpolate(s: ArrayLike, values: Floats, results: Floats) -> Floats:
    """Interpolate linearly in float64, without overflow of differences.

    Parameters
    ----------
    s : (…)
    values : float64 (n,), ascending
    results : float64 (n, k)

    Returns
    -------
    float64 (…, k); 0 where s is NaN
    """
    s = np.asarray(s, np.float64)
    right = np.searchsorted(values, s, side="right")
    left = np.clip(right - 1, 0, len(values) - 1)
    right = np.minimum(right, len(values) - 1)
    # Beyond the first and last value both ends are the same point, and the share has no effect.
    inside = (left != right) & ~np.isnan(s)
    a, b = values[left], values[right]
    at = np.where(inside, s, a)
    half = np.where(np.abs(b) > 1e300, 0.5, 1.0) * np.where(np.abs(a) > 1e300, 0.5, 1.0)
    width = np.where(inside, b * half - a * half, 1.0)
    share = ((at * half - a * half) / width)[..., None]
    found = results[left] + share * (results[right] - results[left])
    return np.where(np.isnan(s)[..., None], 0.0, found)


def distinct(*parts: NDArray[Number]) -> NDArray[Number]:
    """Return the distinct values of arrays, ascending; `numpy.unique` imports `numpy.ma`, which takes 15 ms."""
    values = np.sort(np.concatenate(parts))
    found: NDArray[Number] = values[np.append(True, values[1:] != values[:-1])[: len(values)]]
    return found


def without_hidden_points(values: Floats, results: Floats) -> tuple[Floats, Floats]:
    """Return control points without those between the first and last of a run of equal values."""
    values, results = np.array(values, np.float64), np.array(results, np.float64)
    same_before = np.concatenate([[False], values[1:] == values[:-1]])
    same_after = np.concatenate([values[1:] == values[:-1], [False]])
    seen = ~(same_before & same_after)
    return values[seen], results[seen]
