"""Partial images of projections for tests: scalars of both signs, sums and stretches, and pixels without samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.merge import CLOSED, EXISTS, STARTS, Operator
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect

# All but over.
OPERATORS: tuple[Operator, ...] = ("maximum", "minimum", "sum", "stretch")


def random_pixels(rng: np.random.Generator, count: int, operator: Operator) -> NDArray[np.float32]:
    """What parts of a volume give: float32 (count, 4), some blank, with a stretch of blank or of seen ones."""
    seen = rng.random(count) < rng.choice([0.2, 0.7, 1.0])
    stretch = np.sort(rng.integers(0, count + 1, 2))
    seen[stretch[0] : stretch[1]] = rng.random() < 0.5
    pixels = np.zeros((count, 4), np.float32)
    # Few values, so that many are equal; the scalar 0 is not a blank pixel.
    scalars = rng.choice(np.float32([-1.5, -1e-8, 0, 1e-8, 0.3, 0.7, 1, 40]), (2, count))
    pixels[:, 0], pixels[:, 3] = scalars[0], 1
    if operator == "sum":
        pixels[:, 3] = rng.choice(np.float32([1, 2, 0.3, 17]), count)
        pixels[:, 0] = np.abs(pixels[:, 0]) * rng.random(count, np.float32)
    if operator == "stretch":
        exists = rng.random(count) < 0.7
        flags = EXISTS + rng.choice([0, STARTS], count) + rng.choice([0, CLOSED], count)
        pixels[:, 0] = np.where(exists, scalars[0], 0)
        pixels[:, 1] = np.where(exists, scalars.max(axis=0), scalars[1])
        pixels[:, 2] = np.where(exists, flags, 0)
    pixels[~seen] = 0
    return pixels


def random_part(rng: np.random.Generator, rect: Rect, operator: Operator) -> PartialImage:
    """A part as one rank draws it, read-only."""
    pixels = random_pixels(rng, rect.pixels, operator).reshape(rect.height, rect.width, 4)
    pixels.setflags(write=False)
    return PartialImage(rect, pixels)
