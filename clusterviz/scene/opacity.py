"""Opacity presets: PyVista's names, with PyVista's numbers, over the range of the colour map.

References
----------
PyVista, `opacity_transfer_function`: each preset is a table of 256 bytes, rounded towards zero, whose entries lie at
equal distances from the low to the high end of the scalar range. The rounding is kept: it makes the faint tail of a
sigmoid exactly transparent, and exact zeros are what lets bricks be skipped.
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
    """A preset over the unit range.

    Parameters
    ----------
    name : one of `PRESETS`

    Returns
    -------
    places : float64 (n,), ascending from 0 to 1
    opacities : float64 (n,), in [0, 1]
    """
    places = np.linspace(0.0, 1.0, ENTRIES)
    opacities = _forward(name.removesuffix("_r")) / 255.0
    if name.endswith("_r"):
        opacities = opacities[::-1]
    needed = _bends(opacities)
    return places[needed], opacities[needed]


def opacity_points(
    opacity: float | str | Sequence[Sequence[float]], clim: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Any opacity of a scene as control points in data values.

    Parameters
    ----------
    opacity : a number in [0, 1], a name in `PRESETS`, or ((value, opacity), …) sorted by value
    clim : (low, high), the range over which presets are spread

    Returns
    -------
    values, opacities : float64 (m,), m at least 1, values ascending
    """
    if isinstance(opacity, str):
        places, opacities = preset_points(opacity)
        return spread(places, clim), opacities
    if isinstance(opacity, (int, float)):
        return np.array([clim[0]], np.float64), np.array([opacity], np.float64)
    values, opacities = np.asarray(opacity, np.float64).T
    return values, opacities


def spread(places: NDArray[np.float64], clim: tuple[float, float]) -> NDArray[np.float64]:
    """Places in [0, 1] as data values in [low, high]: exact at both ends, and no overflow at the ends of float64."""
    low, high = clim
    return low * (1.0 - places) + high * places


def _forward(stem: str) -> NDArray[np.float64]:
    """The table of a preset that is not reversed: 256 whole numbers in 0..255."""
    if stem == "linear":
        return np.linspace(0.0, 255.0, ENTRIES)
    if stem == "geom":
        return np.floor(np.geomspace(1e-6, 255.0, ENTRIES))
    if stem == "foreground":
        return np.where(np.arange(ENTRIES) == 0, 0.0, 255.0)
    match = re.fullmatch(r"sigmoid(?:_(\d+))?", stem)
    reach = float(match[1] or 10) if match else 10.0
    return np.floor(255.0 / (1.0 + np.exp(-np.linspace(-reach, reach, ENTRIES))))


def _bends(table: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which entries the piecewise-linear function needs: the ends and every change of slope."""
    needed = np.ones(table.size, bool)
    needed[1:-1] = np.diff(np.round(table * 255.0), 2) != 0
    return needed
