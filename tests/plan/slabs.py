"""Reflectance and transmittance of homogeneous slabs after Kubelka and Munk, in decimal arithmetic of 80 digits."""

from __future__ import annotations

from decimal import MAX_EMAX, MIN_EMIN, Decimal, localcontext
from typing import Any, NamedTuple

import numpy as np


class Slab(NamedTuple):
    """Reflectance and transmittance, float64 (…) each."""

    reflected: Any
    transmitted: Any


def slab(absorption: Any, scattering: Any) -> Slab:
    """Return those of absorption and scattering coefficients times thickness, K d and S d, which are broadcast."""
    return Slab(*np.vectorize(_exact, otypes=[float, float])(absorption, scattering))


def _exact(k: float, s: float) -> tuple[float, float]:
    """Equation 3.20 of the thesis."""
    with localcontext(prec=80, Emax=MAX_EMAX, Emin=MIN_EMIN):
        a, b = Decimal(float(k)), Decimal(float(s))
        x = (a * (a + 2 * b)).sqrt()
        if not x:
            return float(b / (1 + b)), float(1 / (1 + b))
        decay = (-x).exp()  # sinh and cosh are divided by e^x, which may overflow
        sinh, cosh = (1 - decay * decay) / 2, (1 + decay * decay) / 2
        below = (a + b) * sinh + x * cosh
        return float(b * sinh / below), float(x * decay / below)
