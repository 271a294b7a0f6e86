"""Spectrum of a spectral volume: what differs from wavelength to wavelength.

A volume with optics is drawn once for each wavelength, by the same program and from the same bricks; only the records
of the transfer function differ. `Plan.tall` says how the pictures of all are composited together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.volume.optics import optical_function
from clusterviz.image.spectral.from_rgb import reflectance_of
from clusterviz.plan.segments import RECORD, Segments, indexed, outline
from clusterviz.scene.background import background_rgb
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Volume

Floats = NDArray[np.float64]
STEP = 1e-9
"""Least difference of refractive indices before and after a scalar that is a step; less is rounding."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Wavelengths of a plan.

    `segments`: absorption, scattering and the refractive index above that outside at each, as the colour of segments.
    """

    wavelengths: Floats  # float64 (n,), nm
    segments: tuple[Segments, ...]
    background: Floats  # float64 (n,), reflectance of the background

    @property
    def count(self) -> int:
        """Number of wavelengths."""
        return len(self.wavelengths)

    def only(self, number: int) -> Spectrum:
        """Return one wavelength of the spectrum."""
        one = slice(number, number + 1)
        return Spectrum(self.wavelengths[one], self.segments[one], self.background[one])


def make_spectrum(volume: Volume, behind: str | tuple[float, float, float]) -> Spectrum | None:
    """Return the spectrum of a volume over a background; None without optics."""
    if volume.optics is None:
        return None
    function, background = optical_function(volume.optics), background_rgb(behind)
    assert background is not None, "an opaque one is required"
    segments = tuple(_segments(function.at(number)) for number in range(len(function.wavelengths)))
    return Spectrum(function.wavelengths, segments, reflectance_of(background, function.wavelengths))


def _segments(transfer: TransferFunction) -> Segments:
    """Return segments that are not cut, as K, S and the refractive index are linear in the scalar."""
    records, starts = outline(transfer)
    index = transfer.colours[:, 2]
    # A repeated control point is a step where the index differs before and after it.
    records["region"][1:] = np.cumsum(np.abs(index[1::2] - index[::2]) > STEP)
    return indexed(records, starts, (records["unit_opacity"] > 0) | (records["unit_slope"] > 0), RECORD)
