"""Reference of spectral volumes: the two-flux equations solved through a whole stack of layers, in float64.

The fluxes I, away from the eye, and J, towards it, change over the depth z by

    dI/dz = −(K + S) I + S J,    dJ/dz = (K + S) J − S I,

equations 3.17 and 3.18 of the thesis without emission. It prints no sign before d in 3.17; with z away from the eye, as
here, I loses and J, read against its direction, gains. A layer takes (I, J) at its front to (I, J) at its back by a
matrix exponential. The layers are cut until that is well conditioned, and one linear system has the fluxes at all
interfaces, with the light at the front and none at the back. Nothing is composed, and no closed form is used.

`TwoFlux` draws pictures: it composes the slabs of each ray front to back, three numbers a wavelength, with R and T by
equation 3.20 as it is printed.

`symmetrical_front_to_back` is the thesis's composition, equation 3.21, beside it: it takes the reflectance of the stack
so far for the same from both sides. Of four layers with K = 0.14, 0.11, 0.6, 0.06, S = 1.44, 0.76, 0.05, 2.49 and
length 1 it makes R = 0.6054 and T = 0.0506; the equations have R = 0.6005 and T = 0.0346.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.content.volume.optics import OpticalFunction
from clusterviz.errors import InputError
from clusterviz.image.spectral.from_rgb import reflectance_of
from clusterviz.image.spectral.illuminate import illuminate
from clusterviz.image.spectral.lights import illuminant
from clusterviz.image.spectral.picture import SpectralPicture
from clusterviz.image.spectral.two_flux import Fluxes, stacked
from clusterviz.reference.transfer import TransferFunction
from clusterviz.scene.background import RGB

Floats = NDArray[np.float64]
THICKEST = 1.0
"""Largest (K + S) times length of a part of a layer."""
MOST_PARTS = 400
TERMS = 24


def solve_layers(absorption: ArrayLike, scattering: ArrayLike, lengths: ArrayLike) -> Fluxes:
    """Return reflectances and transmittance of a stack of homogeneous layers, the first nearest to the eye.

    `absorption`, `scattering`, `lengths`: (n,) each: K and S per unit of length, and the thickness. Raises InputError:
    the stack needs more than `MOST_PARTS` parts.
    """
    layers = np.stack(np.broadcast_arrays(absorption, scattering, lengths)).astype(np.float64)
    front = _lit(layers)
    back = _lit(layers[:, ::-1])
    return Fluxes(np.float64(front[0]), np.float64(back[0]), np.float64(front[1]))  # type: ignore[arg-type]


def _lit(layers: Floats) -> tuple[float, float]:
    """Return the shares reflected and transmitted of light on the first of layers (3, n)."""
    absorption, scattering, lengths = layers
    depth = (absorption + scattering) * lengths
    counts = np.maximum(np.ceil(depth / THICKEST), 1).astype(int)
    parts = int(counts.sum())
    if parts > MOST_PARTS:
        raise InputError("too thick for the reference", where="two_flux", found=parts, allowed=f"{MOST_PARTS} parts")
    k, s = (np.repeat(each * lengths / counts, counts) for each in (absorption, scattering))
    moves = np.stack([np.stack([-(k + s), s], -1), np.stack([-s, k + s], -1)], -2)
    passed, term = np.broadcast_to(np.eye(2), moves.shape).copy(), np.broadcast_to(np.eye(2), moves.shape)
    for n in range(1, TERMS):
        term = term @ moves / n
        passed += term
    # Unknown: I and J at each interface. Rows: I = 1 at the front, J = 0 at the back, and two for each part.
    system, right = np.zeros((2 * parts + 2, 2 * parts + 2)), np.zeros(2 * parts + 2)
    system[0, 0] = right[0] = system[-1, -1] = 1
    for number, matrix in enumerate(passed):
        rows = slice(2 * number + 1, 2 * number + 3)
        system[rows, 2 * number : 2 * number + 2] = matrix
        system[rows, 2 * number + 2 : 2 * number + 4] = -np.eye(2)
    fluxes = np.linalg.solve(system, right)
    return float(fluxes[1]), float(fluxes[-2])


class TwoFlux:
    """Fluxes of rays at all wavelengths of optics.

    `rays`: number of rays; `function`: of the volume's optics; `background`: sRGB of the background, for `finish`.
    """

    def __init__(self, rays: int, function: OpticalFunction, background: RGB) -> None:
        self.function, self.background = function, background
        shape = rays, len(function.wavelengths)
        self.fluxes = Fluxes(np.zeros(shape), np.zeros(shape), np.ones(shape))

    def of_ray(self, number: int) -> TwoFlux:
        """Return the fluxes of one ray at one wavelength, which has met nothing."""
        function, one = self.function, slice(number, number + 1)
        own = OpticalFunction(
            function.wavelengths[one],
            function.absorption_values,
            function.absorption[:, one],
            function.scattering_values,
            function.scattering[:, one],
        )
        return TwoFlux(1, own, self.background)

    def take(self, rays: NDArray[np.int64], scalar: Floats, valid: NDArray[np.bool_], length: Floats) -> None:
        """Add the next samples of rays."""
        k, s = (np.where(valid, length, 0)[:, None] * each for each in self.function.coefficients(scalar))
        x = np.sqrt(k * (k + 2 * s))
        # Beyond 700 cosh overflows, and T is less than any number.
        growth, ratio = np.minimum(x, 700), np.where(x > 0, x, 1)
        sinh, cosh = np.where(x > 0, np.sinh(growth) / ratio, 1), np.cosh(growth)
        slab = Fluxes(
            s * sinh / (cosh + (k + s) * sinh), s * sinh / (cosh + (k + s) * sinh), 1 / (cosh + (k + s) * sinh)
        )
        for whole, part in zip(self.fluxes, stacked(Fluxes(*(one[rays] for one in self.fluxes)), slab), strict=True):
            whole[rays] = part

    def finish(self, _: TransferFunction) -> Floats:
        """Return rgba, float64 (rays, 4), in daylight before the background."""
        picture = SpectralPicture(Fluxes(*(one[None] for one in self.fluxes)), self.function.wavelengths)
        behind = reflectance_of(self.background, picture.wavelengths)
        rgba: Floats = illuminate(picture, illuminant("D65"), behind)[0].astype(np.float64)
        return rgba


def symmetrical_front_to_back(layers: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return reflectance and transmittance by equation 3.21 of the thesis, which is right for symmetrical stacks only.

    `layers`: (R, T) of each, the first nearest to the eye.
    """
    reflected, transmitted = 0.0, 1.0
    for r, t in layers:
        series = 1 / (1 - reflected * r)
        reflected, transmitted = reflected + transmitted**2 * r * series, transmitted * t * series
    return reflected, transmitted
