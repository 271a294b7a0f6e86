"""Reflectance and transmittance of stacked layers, three numbers a wavelength.

A layer or stack reflects `front` of the light from the side of the eye, `back` of the light from behind, and transmits
`transmitted` in either direction. Two stacks reflect light between them forever; the geometric series are

    front       = f₁ + t₁² f₂ / (1 − b₁ f₂)
    back        = b₂ + t₂² b₁ / (1 − b₁ f₂)
    transmitted = t₁ t₂ / (1 − b₁ f₂)

This is associative, and (0, 0, 1) is its identity, so that parts of a ray can be composed in any grouping. With one
reflectance for both sides, as in equation 3.21 of the thesis, it is neither associative nor right for stacks that are
not symmetrical: `reference.two_flux` has both forms beside each other.

References
----------
P. Kubelka: New contributions to the optics of intensely light-scattering materials, part II: nonhomogeneous layers,
Journal of the Optical Society of America 44(4), 1954.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Fluxes(NamedTuple):
    """Shares of light that layers reflect and transmit.

    Attributes
    ----------
    front, back : reflectances (…) seen from the front and from behind
    transmitted : transmittance (…), the same both ways
    """

    front: NDArray[Any]
    back: NDArray[Any]
    transmitted: NDArray[Any]


def stacked(first: Fluxes, second: Fluxes) -> Fluxes:
    """Compose two stacks, the first in front.

    Parameters
    ----------
    first, second : floats in [0, 1] with front + transmitted <= 1 and back + transmitted <= 1, broadcast

    Notes
    -----
    1 − b₁ f₂ is the sum (1 − b₁) + b₁ (1 − f₂), each bracket at least the transmittance, as in exact arithmetic: light
    that is not reflected is transmitted or absorbed. So nothing cancels, and nothing overflows where reflectances round
    to 1. Each composition adds an error of at most 4 units in the last place of 1 to each number. Small reflectances
    and transmittances keep their digits, but the transmittance behind reflectances within that error of 1 does not.
    Two perfect mirrors transmit nothing.
    """
    within = np.maximum(1 - first.back, first.transmitted)
    between = within + first.back * np.maximum(1 - second.front, second.transmitted)
    series = np.divide(1, between, out=np.zeros_like(between), where=between > 0)
    return Fluxes(
        first.front + first.transmitted * (first.transmitted * series * second.front),
        second.back + second.transmitted * (second.transmitted * series * first.back),
        first.transmitted * series * second.transmitted,
    )


def over_background(fluxes: Fluxes, reflectance: NDArray[Any]) -> NDArray[Any]:
    """Return the reflectance, from the front, of layers before an opaque background of a reflectance in [0, 1]."""
    return stacked(fluxes, Fluxes(reflectance, reflectance, np.zeros_like(reflectance))).front
