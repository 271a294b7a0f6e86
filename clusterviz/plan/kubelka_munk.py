"""Reflectance and transmittance of a homogeneous slab that absorbs and scatters, after Kubelka and Munk.

With k = K d and s = S d, the absorption and scattering coefficients times the thickness, x = √(k (k + 2 s)) and
u = tanh(x) / x, equation 3.20 of the thesis becomes

    R = s u / (1 + (k + s) u),    T = sech(x) / (1 + (k + s) u).

All terms are positive and u is 1 at x = 0, so that nothing cancels and no case is apart: without scattering R = 0 and
T = e^(−k), without absorption R = s / (1 + s) and T = 1 / (1 + s). A slab looks the same from both sides. Slabs are
composed by `image.spectral.two_flux`; shaders/classify/kubelka_munk.glsl is the same for shaders.

References
----------
P. Kubelka, F. Munk: Ein Beitrag zur Optik der Farbanstriche, Zeitschrift für technische Physik 12, 1931.
P. Kubelka: New contributions to the optics of intensely light-scattering materials, part I, Journal of the Optical
Society of America 38(5), 1948.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Slab(NamedTuple):
    """Reflectance and transmittance of a homogeneous slab, (…) each."""

    reflected: NDArray[Any]
    transmitted: NDArray[Any]


def slab(absorption: ArrayLike, scattering: ArrayLike) -> Slab:
    """Return reflectance and transmittance.

    Parameters
    ----------
    absorption, scattering : float32 or float64, broadcast, not negative: K d and S d, coefficients times thickness

    Returns
    -------
    slab : of the same type. The relative error of R is at most 3 units in the last place, that of T at most 4 + x, as
        long as T is a normal number. R + T is at most 1 to a unit, and 1 to a unit without absorption.
    """
    k, s = np.asarray(absorption), np.asarray(scattering)
    tiny = np.finfo(np.result_type(k, s, np.float32)).tiny
    x = np.maximum(np.sqrt(k) * np.sqrt(k + 2 * s), tiny)
    decay = np.exp(-x)
    cosh = 1 + decay * decay
    u = -np.expm1(-x) * (1 + decay) / (x * cosh)
    below = 1 + (k + s) * u
    return Slab(s * u / below, 2 * decay / cosh / below)
