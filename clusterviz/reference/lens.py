"""Reference of a thin lens: the mean of the pictures that its points see.

All rays of a pixel meet in one point of the plane in focus, so that what is there is sharp. The error of the mean falls
as the number of points grows, at about its power −1 for smooth scenes, −3/4 at edges.

Reference: P. Haeberli, K. Akeley: The accumulation buffer: hardware support for high-quality rendering, SIGGRAPH 1990,
4. H. Vogel: A better way to construct the sunflower head, Mathematical Biosciences 44, 1979.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.reference.raycast import render_reference
from clusterviz.reference.rays import Floats
from clusterviz.scene.values import Scene

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def disc_points(count: int) -> Floats:
    """Return points spread evenly over a disc of radius 1, float64 (count, 2), as the seeds of a sunflower."""
    number = np.arange(count)
    radius, angle = np.sqrt((number + 0.5) / count), number * GOLDEN_ANGLE
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def render_lens(scene: Scene, grid: Any, voxels: Any, *, points: Floats, **more: Any) -> Floats:
    """Return the picture of a scene with `camera.aperture`, float64 (h, w, 4), premultiplied.

    `scene`: complete; `grid`, `voxels`, `more`: as of `render_reference`; `points`: float64 (n, 2), of the lens, in its
    radii.
    """
    total: Floats = np.zeros((*scene.image.size[::-1], 4))
    for point in points:
        total += render_reference(scene, grid, voxels, lens_point=point.tolist(), **more)
    return total / len(points)
