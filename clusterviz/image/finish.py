"""Conversion of float pixels over a background to bytes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError

Colour = tuple[float, float, float]


def finish(rgba: NDArray[np.float32], background: Colour | None) -> NDArray[np.uint8]:
    """Blend a premultiplied picture over its background and round it to bytes.

    Parameters
    ----------
    rgba : float32 (h, w, 4), premultiplied
    background : (r, g, b) in [0, 1], or None for transparent

    Returns
    -------
    pixels : uint8 (h, w, 3) over the background, or uint8 (h, w, 4) with straight alpha if it is transparent. Values
        are clipped to [0, 1] and rounded to the nearest of 256 levels; NaN becomes 0.

    Raises
    ------
    InputError
        `rgba` is not (h, w, 4).

    References
    ----------
    T. Porter, T. Duff: Compositing digital images, SIGGRAPH 1984.
    """
    if rgba.ndim != 3 or rgba.shape[2] != 4:
        raise InputError("not a picture", where="finish", found=f"shape {rgba.shape}", allowed="(h, w, 4)")
    if background is not None:
        # The error of float32 is about 1e-7, a level 4e-3: the byte is exact except at ties. A channel at a time, since
        # NumPy is slow on a last axis of 3.
        blended, rest = np.empty((*rgba.shape[:2], 3), np.float32), 1 - rgba[..., 3]
        for channel, colour in enumerate(np.asarray(background, np.float32)):
            np.multiply(rest, colour, out=blended[..., channel])
            blended[..., channel] += rgba[..., channel]
        return _bytes(blended)
    alpha = rgba[..., 3:]
    straight = np.zeros(rgba.shape, np.float32)
    with np.errstate(over="ignore"):
        np.divide(rgba[..., :3], alpha, out=straight[..., :3], where=alpha > 0)
    straight[..., 3:] = alpha
    return _bytes(straight)


def as_shown(rgba: NDArray[np.float32], background: Colour | None) -> NDArray[np.float32]:
    """Return the premultiplied picture, float32 (h, w, 4), that a reader finds in the bytes of `finish`."""
    found = finish(rgba, background).astype(np.float32) / np.float32(255)
    if background is not None:
        return np.dstack([found, np.ones(found.shape[:2], np.float32)])
    found[..., :3] *= found[..., 3:]
    return found


def _bytes(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Round [0, 1] to the nearest of 0…255; overwrites `values`."""
    np.fmax(values, 0, out=values)  # 0 for NaN, unlike np.clip
    np.minimum(values, 1, out=values)
    values *= 255
    values += 0.5
    return values.astype(np.uint8)
