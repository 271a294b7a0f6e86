"""Transfer functions of the reference: colour and opacity of a scalar from what a completed scene says.

Only the stops of named colour maps, and the files of presets and tables, are read by the code that the renderer uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clusterviz.content.grid.section import GridSection
from clusterviz.content.volume.optics import optical_function
from clusterviz.reference.rays import Floats
from clusterviz.scene.colormaps import named_colour_points, read_preset
from clusterviz.scene.transfer_2d import load_table
from clusterviz.scene.values import Volume

OPAQUE = 1 - 2.0**-24
"""Largest opacity; see docs/reference/conventions.md."""
TABLE = 256
"""Entries of a preset of opacity: whole numbers of 255, rounded towards zero."""


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """Piecewise-linear colour and opacity of a scalar."""

    # float64 (n,), (n, 3), straight RGB
    colour_values: Floats
    colours: Floats
    # float64 (m,)
    opacity_values: Floats
    opacities: Floats
    unit_distance: float  # world units over which opacities hold
    domain: tuple[float, float]  # (low, high), low < high, of the colour map

    def colour(self, s: ArrayLike) -> Floats:
        """Return straight RGB, float64 (…, 3), of scalars (…)."""
        return interpolate(s, self.colour_values, self.colours)

    def opacity(self, s: ArrayLike) -> Floats:
        """Return opacity over the unit distance, float64 (…), of scalars (…)."""
        return interpolate(s, self.opacity_values, self.opacities[:, None])[..., 0]

    def extinction(self, s: ArrayLike) -> Floats:
        """Return extinction per world unit, float64 (…), of scalars (…)."""
        return -np.log1p(-np.minimum(self.opacity(s), OPAQUE)) / self.unit_distance


def transfer_function(volume: Volume | GridSection) -> TransferFunction:
    """Return the transfer function of a completed volume or unstructured grid; see `scene.complete.transfer_function`.

    Raises ValueError: the volume is not completed.
    """
    if isinstance(volume, Volume) and volume.optics is not None:
        one = optical_function(volume.optics).at(0)
        points = one.colour_values, one.colours, one.opacity_values, one.opacities
        return TransferFunction(*points, one.unit_distance, one.domain)
    clim, unit, cmap = volume.clim, volume.opacity_unit_distance, volume.cmap
    table = volume.transfer_2d if isinstance(volume, Volume) else None
    if clim is None or unit is None or cmap is None or (volume.opacity is None and table is None):
        raise ValueError("the volume is not completed")
    if table is not None:
        # The opacity of a scalar is the largest over all magnitudes.
        largest, (low, high) = load_table(table).opacities.max(axis=0), table.values or clim
        opacities = _over(np.linspace(0, 1, len(largest)), (low, high)), largest
    else:
        opacities = opacity_points(volume.opacity, clim)
    domain = clim
    if not clim[0] < clim[1]:
        half, most = max(0.5, abs(clim[0]) * 2.0**-20), float(np.finfo(np.float64).max)
        domain = max(clim[0] - half, -most), min(clim[0] + half, most)
    return TransferFunction(*colour_points(cmap, clim), *opacities, unit, domain)


def colour_points(cmap: str | Sequence[Sequence[float]], clim: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return values, float64 (n,), and straight colours, float64 (n, 3), of a scene's colour map."""
    if isinstance(cmap, str):
        places, colours = read_preset(cmap)[:2] if cmap.lower().endswith(".json") else named_colour_points(cmap)
        return _over(places, clim), colours
    rows = np.array(cmap, np.float64)
    return (_over(np.linspace(0, 1, len(rows)), clim), rows) if rows.shape[1] == 3 else (rows[:, 0], rows[:, 1:])


def opacity_points(opacity: Any, clim: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return values and opacities, float64 (m,), of a scene's opacity: a number, a preset's name or points."""
    if isinstance(opacity, str):
        return _over(np.linspace(0, 1, TABLE), clim), _preset(opacity)
    rows = np.array([(clim[0], opacity)] if np.ndim(opacity) == 0 else opacity, np.float64)
    return rows[:, 0], rows[:, 1]


def _preset(name: str) -> Floats:
    """Return the entries of a preset, float64 (256,); a reversed one has them in reverse."""
    stem, reach = name.removesuffix("_r"), 10
    if stem.startswith("sigmoid_"):
        stem, reach = "sigmoid", int(stem.removeprefix("sigmoid_"))
    at = np.arange(TABLE) / (TABLE - 1)
    entries = {
        "linear": at,
        "geom": np.floor(1e-6 * (255 / 1e-6) ** at * (1 + 1e-12)) / 255,
        "sigmoid": np.floor(255 / (1 + np.exp(reach * (1 - 2 * at)))) / 255,
        "foreground": np.sign(at),
    }[stem]
    return entries[::-1] if name.endswith("_r") else entries


def interpolate(s: ArrayLike, values: Floats, results: Floats) -> Floats:
    """Interpolate linearly; at a repeated value the last result counts.

    `s`: (…); `values`: float64 (n,), ascending; `results`: float64 (n, k).

    Returns
    -------
    float64 (…, k); 0 where s is NaN
    """
    # A power of two keeps the bits, and in a range around 1 neither differences nor slopes overflow.
    exponent = -int(np.frexp(np.abs(values).max())[1])
    with np.errstate(over="ignore"):
        s, values = np.ldexp(np.asarray(s, np.float64), exponent), np.ldexp(values, exponent)
    found = np.stack([np.interp(s, values, column) for column in np.asarray(results, np.float64).T], axis=-1)
    return np.where(np.isnan(s)[..., None], 0.0, found)


def _over(places: Floats, clim: tuple[float, float]) -> Floats:
    """Return places in [0, 1] in data values."""
    low, high = clim
    return low * (1 - places) + high * places
