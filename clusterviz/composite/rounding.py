"""Partial images in fewer bits: `quality.pixel`. What travels and is blended is half as many bytes, or a quarter.

A value is rounded to nearest when it is drawn and, wherever images are merged, once more. Products and sums are float32
in between. Let n images lie behind each other, premultiplied, with full scale 1.

- float16 rounds a value by at most 2⁻¹¹ of itself. Errors of colours add up to that share of the finished colour,
  errors of opacities to that share of what they let through: 2⁻¹⁰ for all images together, however many there are. Each
  time that images are merged and travel on adds as much, and no algorithm lets a value travel more than n − 1 times.
- uint8 rounds a value by at most 1/510. That is 1/255 for each image: half for its colour, half for what its opacity
  lets through; merges round at most n − 1 images once more.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Pixels
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.composite.patch import Patch
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect

FULL_SCALE = 255


def rounded(partial: PartialImage, pixel: str) -> PartialImage:
    """A partial image with its values rounded to nearest.

    Parameters
    ----------
    partial : float32, from 0 to 1
    pixel : float32, float16 or uint8
    """
    if partial.rgba.dtype == pixel:
        return partial
    height, width = partial.rgba.shape[:2]
    rgba: NDArray[Any] = np.empty(partial.rgba.shape, pixel)
    if rgba.size:
        # The kernel that blends many layers converts one ten times as fast as NumPy.
        patch = Patch(width, 0, height * width, Rect(0, 0, width, height))
        pixels = np.ascontiguousarray(partial.rgba).reshape(-1, 4)
        blend_layers([Layer(patch, pixels)], patch, rgba.reshape(-1, 4))
    return PartialImage(partial.rect, rgba)


def as_floats(pixels: Pixels) -> NDArray[np.float32]:
    """Pixels of any type as float32, bytes in units of full scale; in memory of their own."""
    floats = pixels.astype(np.float32)
    if pixels.dtype == np.uint8:
        floats /= FULL_SCALE
    return floats


def rounding_bound(pixel: str, images: int) -> float:
    """How far rounding puts any channel of the picture off at most, of a full scale of 1.

    Parameters
    ----------
    pixel : float32, float16 or uint8
    images : that may lie behind each other, of all ranks together
    """
    match pixel:
        case "uint8":
            return 2 * images / FULL_SCALE
        case "float16":
            return images * 2.0**-10
        case _:
            return images * 2.0**-23
