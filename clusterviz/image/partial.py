"""Partial image: rectangle of premultiplied pixels that one rank drew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.region import EMPTY, Rect


@dataclass(frozen=True)
class PartialImage:
    """Pixels that one rank drew; everything outside `rect` is fully transparent.

    Attributes
    ----------
    rect : Rect
        The footprint on the screen.
    rgba : float32, float16 or uint8 (rect.height, rect.width, 4), premultiplied, C order
    """

    rect: Rect
    rgba: NDArray[np.float32] | NDArray[np.float16] | NDArray[np.uint8]


def blank() -> PartialImage:
    """Return an empty partial image."""
    return PartialImage(EMPTY, np.zeros((0, 0, 4), np.float32))


def joined(parts: Sequence[PartialImage]) -> PartialImage:
    """Return partial images that do not overlap as one of the first one's type, transparent between them."""
    rect = EMPTY
    for part in parts:
        rect = rect.unite(part.rect)
    if len(parts) == 1 or rect.pixels == 0:
        return parts[0] if parts else blank()
    rgba = np.zeros((rect.height, rect.width, 4), parts[0].rgba.dtype)
    for part in parts:
        y, x = part.rect.y_begin - rect.y_begin, part.rect.x_begin - rect.x_begin
        rgba[y : y + part.rect.height, x : x + part.rect.width] = part.rgba
    return PartialImage(rect, rgba)
