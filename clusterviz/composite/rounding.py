"""Partial images with 16 or 8 bits per channel (`quality.pixel`), and bounds of the rounding error.

A value is rounded to nearest when it is drawn, and again wherever images are merged. Products and sums are float32.
Let n premultiplied images with full scale 1 lie behind each other.

- float16 rounds a value by at most 2⁻¹¹ of itself. The errors of colours add up to that fraction of the final colour,
  the errors of opacities to that fraction of the light that they transmit: 2⁻¹⁰ for any number of images. Each merge
  before a value travels on adds as much, and no algorithm lets a value travel more than n − 1 times.
- uint8 rounds a value by at most 1/510. That is 1/255 for each image: half for its colour, half for the light that its
  opacity transmits. Merges round at most n − 1 images again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.codec.contract import Pixels
from clusterviz.composite.fragment import Patch
from clusterviz.composite.over.layers import Layer, blend_layers
from clusterviz.image.partial import PartialImage, Rect

FULL_SCALE = 255


def rounded(partial: PartialImage, pixel: str) -> PartialImage:
    """Return a partial image with its values rounded to nearest. `pixel`: pixel type: float32, float16 or uint8."""
    if partial.rgba.dtype == pixel:
        return partial
    height, width = partial.rgba.shape[:2]
    rgba: NDArray[Any] = np.empty(partial.rgba.shape, pixel)
    if rgba.size:
        # The kernel that blends layers converts one ten times as fast as NumPy.
        patch = Patch(width, 0, height * width, Rect(0, 0, width, height))
        pixels = np.ascontiguousarray(partial.rgba).reshape(-1, 4)
        blend_layers([Layer(patch, pixels)], patch, rgba.reshape(-1, 4))
    return PartialImage(partial.rect, rgba)


def as_floats(pixels: Pixels) -> NDArray[np.float32]:
    """Return a copy of pixels of any type as float32, bytes divided by full scale."""
    floats = pixels.astype(np.float32)
    if pixels.dtype == np.uint8:
        floats /= FULL_SCALE
    return floats


def rounding_bound(pixel: str, images: int) -> float:
    """Return the largest rounding error of any channel of the picture, with full scale 1.

    `pixel`: pixel type: float32, float16 or uint8; `images`: most images that lie behind each other, of all ranks
    together.
    """
    match pixel:
        case "uint8":
            return 2 * images / FULL_SCALE
        case "float16":
            return images * 2.0**-10
        case _:
            return images * 2.0**-23
