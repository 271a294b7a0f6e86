"""From spectra to sRGB: the CIE 1964 observer, adaptation, exposure, gamut and encoding.

- Reflectances are linear between the wavelengths of a picture and constant beyond the first and last one. The integrals
  with the light and the observer are then sums over the wavelengths with weights. So wavelengths may be spaced in any
  way, one alone gives shades of the light's colour, and all the lines of a fluorescent lamp count. A sum of products at
  the wavelengths themselves, as in the thesis, misses lines between them.
- XYZ are divided by the luminance of a perfect white reflector. The white of D65, as the 1964 observer sees it, becomes
  (1, 1, 1) by linear Bradford adaptation, since the white point of sRGB is that of the 1931 observer. Other lights keep
  their colour, or are adapted to in the same way, which shows white reflectors white.
- Exposure: a light that is not white is dimmed until a white reflector fits into the range of the display.
- Out of gamut: a colour is mixed with the grey of its own luminance, as little as possible, so that its hue stays.

The thesis's matrix from XYZ to RGB (3.3.3) is that of the NTSC primaries of 1953 and D65, with −0.955 printed as
−0.5388, and −0.130 and −0.027 exchanged: as printed, D65 becomes (1.00, 1.28, 1.10). It is not used.

References
----------
IEC 61966-2-1:1999 with amendment 1 (sRGB). K. M. Lam: Metamerism and colour constancy, PhD thesis, University of
Bradford, 1985. CIE 15:2004.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.image.spectral.lights import Floats, Light, illuminant, read_table

SRGB_FROM_XYZ = np.array(
    [
        [3.2406255, -1.5372080, -0.4986286],
        [-0.9689307, 1.8757561, 0.0415175],
        [0.0557101, -0.2040211, 1.0569959],
    ]
)
"""IEC 61966-2-1, amendment 1, to linear sRGB."""
LUMINANCE = np.linalg.inv(SRGB_FROM_XYZ)[1]
"""Luminance of each linear primary."""
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def xyz_weights(wavelengths: Floats, light: Light) -> Floats:
    """Return weights for reflectances at the wavelengths of a picture under a light.

    Parameters
    ----------
    wavelengths : float64 (n,), nm, ascending, n >= 1

    Returns
    -------
    weights : float64 (n, 3): XYZ are reflectances (…, n) @ weights; a white reflector has Y = 1
    """
    observer = read_table("observer_1964.csv")
    matched = np.stack([np.interp(light.wavelengths, observer[:, 0], observer[:, 1 + axis]) for axis in range(3)], 1)
    energy = light.powers[:, None] * matched
    after = np.searchsorted(wavelengths, light.wavelengths)
    left, right = np.maximum(after - 1, 0), np.minimum(after, len(wavelengths) - 1)
    distance = np.where(left < right, wavelengths[right] - wavelengths[left], 1.0)
    share = np.clip((light.wavelengths - wavelengths[left]) / distance, 0, 1)[:, None]
    weights = np.zeros((len(wavelengths), 3))
    np.add.at(weights, left, (1 - share) * energy)
    np.add.at(weights, right, share * energy)
    found: Floats = weights / energy[:, 1].sum()
    return found


def srgb_weights(wavelengths: Floats, light: Light, adapt: bool = False) -> Floats:
    """Return weights as of `xyz_weights` for linear sRGB, adapted and exposed, but not mapped into the gamut.

    Parameters
    ----------
    adapt : show white reflectors white under this light

    Raises
    ------
    InputError
        `adapt` with a light that stimulates some cones only, such as a laser.
    """
    white = xyz_weights(wavelengths, light).sum(axis=0)
    daylight = xyz_weights(wavelengths, illuminant("D65")).sum(axis=0)
    cones = BRADFORD @ white
    if adapt and not (cones > 1e-3).all():
        raise InputError("has no white to adapt to", where=light.name, allowed="a light with red, green and blue")
    gains = (BRADFORD @ np.linalg.solve(SRGB_FROM_XYZ, np.ones(3))) / (cones if adapt else BRADFORD @ daylight)
    rgb_from_xyz = SRGB_FROM_XYZ @ np.linalg.solve(BRADFORD, gains[:, None] * BRADFORD)
    brightest = float(into_gamut(rgb_from_xyz @ white, most=np.inf).max())
    found: Floats = xyz_weights(wavelengths, light) @ rgb_from_xyz.T / max(brightest, 1.0)
    return found


def into_gamut(rgb: NDArray[Any], most: float = 1.0) -> NDArray[Any]:
    """Return linear colours (…, 3) with components in [0, most], of the same hue and luminance where that fits.

    A colour outside is mixed with the grey of its luminance; a luminance outside of the range is moved to its end.
    """
    grey = np.clip(rgb @ LUMINANCE.astype(rgb.dtype), 0, most)[..., None]
    low, high = rgb.min(axis=-1, keepdims=True), rgb.max(axis=-1, keepdims=True)
    # The largest share of the colour that keeps the lowest component above 0, and the highest below `most`.
    down = np.divide(grey, grey - low, out=np.ones_like(grey), where=low < 0)
    up = np.divide(most - grey, high - grey, out=np.ones_like(grey), where=high > most)
    mixed: NDArray[Any] = np.clip(grey + np.minimum(down, up) * (rgb - grey), 0, most)
    return mixed


def encoded(rgb: NDArray[Any]) -> NDArray[Any]:
    """Return the sRGB values, (…), of linear components in [0, 1]."""
    found: NDArray[Any] = np.where(
        rgb <= 0.0031308, 12.92 * rgb, 1.055 * np.maximum(rgb, 0.0031308) ** (1 / 2.4) - 0.055
    )
    return found


def decoded(rgb: NDArray[Any]) -> NDArray[Any]:
    """Return the linear components, (…), of sRGB values in [0, 1]."""
    found: NDArray[Any] = np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0.04045) + 0.055) / 1.055) ** 2.4)
    return found
