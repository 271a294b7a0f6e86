"""How far before what the last frame found rays start: `quality.frame_coherence`.

The hits of four neighbouring rays bound what lies between them as far as the field is smooth: two slabs are room for
what it bulges. Voxels that stand for themselves are boxes, whose corners jut out by as much as their diagonal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from clusterviz.data.grid import Grid
from clusterviz.scene.values import Scene

BULGE = 2  # slabs


def make_frame_coherence(scene: Scene, grids: Sequence[Grid], step_world: float) -> int | None:
    """Slabs between a ray's start and what the last frame found; None where rays start as if there had been none.

    Parameters
    ----------
    grids : of the scene's volumes
    """
    if not scene.quality.frame_coherence:
        return None
    boxes = [grid for volume, grid in zip(scene.volumes, grids, strict=True) if volume.interpolation == "nearest"]
    juts = max((math.hypot(*grid.spacing) for grid in boxes), default=0.0)
    return BULGE + math.ceil(juts / step_world)
