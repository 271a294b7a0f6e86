"""Materials: absorption, scattering and refractive index over wavelengths, from tables of measurements or from colours.

A table has the coefficients of light transport: absorption μa, and scattering μs′ = μs (1 − g) without its forward
part. In the two-flux equations, for diffuse light, K = 2 μa and S = 3/4 μs′; the 2 is the mean length of diffuse rays
through a thin layer. Each table names its sources in its first lines.

Reference: L. F. Gate: Comparison of the photon diffusion model and Kubelka-Munk equation with the exact solution of the
radiative transport equation, Applied Optics 13(2), 1974. S. N. Thennadil: Relationship between the Kubelka-Munk
scattering and radiative transfer coefficients, Journal of the Optical Society of America A 25(7), 2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.image.spectral.from_rgb import reflectance_of

Floats = NDArray[np.float64]
TABLES = Path(__file__).parent
MATERIALS: dict[str, str] = {
    "air": "nothing, refractive index 1",
    "water": "pure water, which absorbs a little red",
    "blood": "whole blood with oxygen",
    "blood-deoxygenated": "whole blood without oxygen",
    "epidermis": "outer layer of human skin",
    "dermis": "inner layer of human skin",
    "fat": "subcutaneous fat",
    "bone": "bone without blood",
    "intralipid": "a white fat emulsion, 20 %",
    "glass": "crown glass, which is clear, N-BK7",
    "flint-glass": "dense flint glass, which disperses more, N-SF11",
}
"""What is known by name, with a line for people. All but air have a table, NAME.csv, beside this module."""
DARKEST = 1e-3
"""Smallest reflectance of a colour; a smaller one would need a huge absorption."""


@dataclass(frozen=True, eq=False)
class Material:
    wavelengths: Floats  # float64 (n,), nm, ascending
    # float64 (n,), K and S of the two-flux equations, per millimetre
    absorption: Floats
    scattering: Floats
    refractive_index: Floats  # float64 (n,)

    def at(self, wavelengths: ArrayLike) -> Material:
        """Return the material at other wavelengths, by linear interpolation."""
        wanted = np.asarray(wavelengths, np.float64)
        properties = (self.absorption, self.scattering, self.refractive_index)
        return Material(wanted, *(np.interp(wanted, self.wavelengths, each) for each in properties))


@cache
def material(name: str) -> Material:
    """Return a material of `MATERIALS`, which are known from 380 to 780 nm."""
    if name == "air":
        return Material(np.array([380.0, 780.0]), np.zeros(2), np.zeros(2), np.ones(2))
    wavelengths, absorption, scattering, index = np.loadtxt(TABLES / f"{name}.csv", delimiter=",").T
    return Material(wavelengths, 2 * absorption, 0.75 * scattering, index)


def material_of_colour(rgb: Sequence[float], wavelengths: Floats) -> Material:
    """Return a material that has a colour in thick layers: K / S = (1 − R)² / (2 R) for the colour's reflectance R.

    `rgb`: sRGB values in [0, 1]. `wavelengths`: nm; the colour is met in pictures of these wavelengths. S is 1 per
    millimetre at all of them.
    """
    reflectance = np.maximum(reflectance_of(rgb, wavelengths), DARKEST)
    same = np.ones_like(reflectance)
    return Material(wavelengths, (1 - reflectance) ** 2 / (2 * reflectance), same, same)
