"""Transfer functions: colour and opacity of a scalar.

Reference: PyVista, `opacity_transfer_function`: each preset is a table of 256 bytes, rounded towards zero, at equal
distances over the scalar range. The rounding makes the tail of a sigmoid exactly transparent, so that bricks can be
skipped.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

ENTRIES = 256
SIGMOIDS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15, 20)
FORWARD = ("linear", "geom", "sigmoid", *(f"sigmoid_{a}" for a in SIGMOIDS))
PRESETS = (*FORWARD, *(f"{name}_r" for name in FORWARD), "foreground")
PRESET_NAMES = (
    f"linear, geom, sigmoid, {', '.join(f'sigmoid_{a}' for a in SIGMOIDS)}, each with _r for its reverse, foreground"
)


def preset_points(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the control points of a preset over [0, 1].

    `name`: one of `PRESETS`. Returns `places`, float64 (n,), ascending from 0 to 1; `opacities`, float64 (n,), in [0,
    1].
    """
    places = np.linspace(0.0, 1.0, ENTRIES)
    opacities = _preset_table(name.removesuffix("_r")) / 255.0
    if name.endswith("_r"):
        opacities = opacities[::-1]
    needed = _needed_points(opacities)
    return places[needed], opacities[needed]


def opacity_points(
    opacity: float | str | Sequence[Sequence[float]], clim: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the control points of a scene's opacity in data values.

    `opacity`: a number in [0, 1], a name in `PRESETS`, or ((value, opacity), …) sorted by value; `clim`: (low, high),
    data values, the range of presets. Returns `values`, float64 (m,), m >= 1, ascending; `opacities`, float64 (m,), in
    [0, 1].
    """
    if isinstance(opacity, str):
        places, opacities = preset_points(opacity)
        return rescale(places, clim), opacities
    if isinstance(opacity, (int, float)):
        return np.array([clim[0]], np.float64), np.array([opacity], np.float64)
    values, opacities = np.asarray(opacity, np.float64).T
    return values, opacities


def rescale(places: NDArray[np.float64], clim: tuple[float, float]) -> NDArray[np.float64]:
    """Map [0, 1] to [low, high], exactly at both ends and without overflow."""
    low, high = clim
    return low * (1.0 - places) + high * places


def _preset_table(stem: str) -> NDArray[np.float64]:
    """Return the table of a preset without _r, float64 (256,), whole numbers in 0..255 but for linear."""
    if stem == "linear":
        return np.linspace(0.0, 255.0, ENTRIES)
    if stem == "geom":
        return np.floor(np.geomspace(1e-6, 255.0, ENTRIES))
    if stem == "foreground":
        return np.where(np.arange(ENTRIES) == 0, 0.0, 255.0)
    match = re.fullmatch(r"sigmoid(?:_(\d+))?", stem)
    reach = float(match[1] or 10) if match else 10.0
    return np.floor(255.0 / (1.0 + np.exp(-np.linspace(-reach, reach, ENTRIES))))


def _needed_points(table: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of the entries that a piecewise-linear function needs: both ends and changes of slope."""
    needed = np.ones(table.size, bool)
    needed[1:-1] = np.diff(np.round(table * 255.0), 2) != 0
    return needed


Floats = NDArray[np.float64]
Number = TypeVar("Number", bound=np.number[Any])
OPAQUE = 1.0 - 2.0**-24
"""Largest opacity, so that extinction is finite; less than half a float32 step from 1."""


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """Piecewise-linear colour and opacity of a scalar, constant beyond the first and last control point.

    A repeated value is a step; at exactly that scalar the later control point applies. NaN has colour 0 and opacity 0.
    """

    colour_values: Floats  # float64 (n,), ascending, n >= 1
    colours: Floats  # float64 (n, 3), straight RGB in [0, 1]
    opacity_values: Floats  # float64 (m,), ascending, m >= 1
    opacities: Floats  # float64 (m,), over `unit_distance`, in [0, 1]
    unit_distance: float  # world units, more than 0
    # (low, high), low < high: `clim` of the volume, or a range around it if both ends are equal
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

        `low`, `high`: (…), the ends of the intervals; an empty interval (low > high) is transparent. Returns bool (…);
        False where an end is NaN.
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

    `s`: (…); `values`: float64 (n,), ascending; `results`: float64 (n, k).

    Returns
    -------
    float64 (…, k); 0 where s is NaN
    """
    s = np.asarray(s, np.float64)
    right = np.searchsorted(values, s, side="right")
    left = np.maximum(right - 1, 0)
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
