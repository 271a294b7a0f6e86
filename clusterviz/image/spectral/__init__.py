"""Spectral pictures: reflectances and transmittances at several wavelengths, illuminated after they are rendered.

two_flux.py    composition of layers: reflectance from both sides, and transmittance
picture.py     picture before it is illuminated, and its files
lights.py      light sources: D65, A, F11, equal energy, lasers, tables
colour.py      from spectra to sRGB
from_rgb.py    from sRGB to reflectance spectra
illuminate.py  colours of a picture under a light
tables/        numbers of the CIE
"""

from __future__ import annotations

from clusterviz.image.spectral.from_rgb import reflectance_of
from clusterviz.image.spectral.illuminate import illuminate
from clusterviz.image.spectral.lights import Light, illuminant, laser, light_of, read_light, spectrum
from clusterviz.image.spectral.picture import SpectralPicture, read_spectral, write_spectral
from clusterviz.image.spectral.two_flux import Fluxes, over_background, stacked

__all__ = [
    "Fluxes",
    "Light",
    "SpectralPicture",
    "illuminant",
    "illuminate",
    "laser",
    "light_of",
    "over_background",
    "read_light",
    "read_spectral",
    "reflectance_of",
    "spectrum",
    "stacked",
    "write_spectral",
]
