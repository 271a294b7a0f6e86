"""How far before what the last frame found rays start: `quality.leaping`.

The hits of four neighbouring rays bound what lies between them as far as the field is smooth: two slabs are room for
what it bulges. Voxels that stand for themselves are boxes, whose corners jut out by as much as their diagonal.
"""

from __future__ import annotations

import math

from clusterviz.data.grid import Grid
from clusterviz.scene.values import Quality, Volume

BULGE = 2  # slabs


def make_leaping(volume: Volume, quality: Quality, grid: Grid, step_world: float) -> int | None:
    """Slabs between a ray's start and what the last frame found; None where rays start as if there had been none."""
    if not quality.leaping:
        return None
    juts = math.hypot(*grid.spacing) if volume.interpolation == "nearest" else 0.0
    return BULGE + math.ceil(juts / step_world)
