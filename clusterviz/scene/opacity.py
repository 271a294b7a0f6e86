"""Opacity presets with PyVista's names and values, over the range of the colour map.

References
----------
PyVista, `opacity_transfer_function`: each preset is a table of 256 bytes, rounded towards zero, at equal distances over
the scalar range. The rounding makes the tail of a sigmoid exactly transparent, so that bricks can be skipped.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

ENTRIES = 256
SIGMOIDS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15, 20)
FORWARD = ("linear", "geom", "sigmoid", *(f"sigmoid_{a}" for a in SIGMOIDS))
PRESETS = (*FORWARD, *(f"{name}_r" for name in FORWARD), "foreground")
PRESET_NAMES = (
    f"linear, geom, sigmoid, {', '.join(f'sigmoid_{a}' for a in SIGMOIDS)}, each with _r for its reverse, foreground"
)


def preset_points(name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the control points of a preset over [0, 1].

    Parameters
    ----------
    name : one of `PRESETS`

    Returns
    -------
    places : float64 (n,), ascending from 0 to 1
    opacities : float64 (n,), in [0, 1]
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

    Parameters
    ----------
    opacity : a number in [0, 1], a name in `PRESETS`, or ((value, opacity), …) sorted by value
    clim : (low, high), data values, the range of presets

    Returns
    -------
    values : float64 (m,), m >= 1, ascending
    opacities : float64 (m,), in [0, 1]
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
