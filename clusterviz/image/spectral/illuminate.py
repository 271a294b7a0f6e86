"""Illumination of spectral pictures, without rendering again: the light comes from the side of the eye."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clusterviz.errors import InputError
from clusterviz.image.spectral.colour import decoded, encoded, into_gamut, srgb_weights
from clusterviz.image.spectral.from_rgb import reflectance_of
from clusterviz.image.spectral.lights import Light, illuminant
from clusterviz.image.spectral.picture import SpectralPicture
from clusterviz.image.spectral.two_flux import Fluxes, over_background


def illuminate(
    picture: SpectralPicture, light: Light, background: ArrayLike = 1.0, *, adapt: bool = False, linear: bool = False
) -> NDArray[np.float32]:
    """Return the colours of a picture before an opaque background, under a light.

    Parameters
    ----------
    background : reflectance of the background in [0, 1]: a number, or (n,), or (h, w, n)
    adapt : show white reflectors white under any light, as an eye does after a while; else D65 is white
    linear : return linear sRGB, not mapped into its gamut, as OpenEXR files have it. Without it, colours are mapped
        into the gamut and encoded by the function of sRGB, as PNG files have them. Other pictures of clusterviz are
        not encoded, since their colours are those of a colour map, given for the display; here they are sums of light.

    Returns
    -------
    rgba : float32 (h, w, 4); opacity is 1

    Raises
    ------
    InputError
        A background of another shape or outside of [0, 1], or `adapt` with a light that has no white.
    """
    shape = picture.fluxes.front.shape
    behind = np.asarray(background, np.float32)
    if behind.ndim > 3 or behind.shape not in ((), shape[2:], shape):
        allowed = f"a number, {shape[2:]} or {shape}"
        raise InputError("shapes do not fit", where="background", found=f"{behind.shape}", allowed=allowed)
    if not ((behind >= 0) & (behind <= 1)).all():
        raise InputError(
            "not a reflectance", where="background", found=f"{behind.min()} to {behind.max()}", allowed="0 to 1"
        )
    weights = srgb_weights(picture.wavelengths, light, adapt)
    rgba = np.ones((*shape[:2], 4), np.float32)
    # By rows, so that temporary arrays stay small.
    for y in range(shape[0]):
        fluxes = Fluxes(*(values[y] for values in picture.fluxes))
        rgb = over_background(fluxes, behind[y] if behind.ndim == 3 else behind) @ weights
        rgba[y, :, :3] = rgb if linear else encoded(into_gamut(rgb))
    return rgba


def linear_picture(
    rgba: NDArray[np.float32], layers: Mapping[str, NDArray[Any]], background: Sequence[float]
) -> NDArray[np.float32]:
    """Return a picture in daylight with linear colours; what was drawn over it, such as annotations, is decoded.

    Parameters
    ----------
    rgba : float32 (h, w, 4), encoded
    layers : of the picture, see `SpectralPicture.layers`
    background : its colour, sRGB
    """
    picture = SpectralPicture.of_layers(layers)
    behind, rgba = reflectance_of(background, picture.wavelengths), np.asarray(rgba)
    shown, found = (illuminate(picture, illuminant("D65"), behind, linear=linear) for linear in (False, True))
    over = (rgba != shown).any(axis=-1)
    found[over] = np.append(decoded(rgba[over, :3]), rgba[over, 3:], axis=-1)
    return found
