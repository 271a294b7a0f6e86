"""Distance between the start of a ray and the last frame's hit: `quality.frame_coherence`.

The hits of four neighbouring rays bound a smooth surface between them but for its bulge, for which two slabs are added.
With nearest-voxel interpolation voxels are boxes, so their diagonal is added.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from clusterviz.data.grid import Grid
from clusterviz.scene.values import Scene

BULGE = 2  # slabs


def make_frame_coherence(scene: Scene, grids: Sequence[Grid], step_world: float) -> int | None:
    """Return the slabs between a ray's start and the last frame's hit; None without frame coherence.

    Parameters
    ----------
    grids : of the scene's volumes
    """
    if not scene.quality.frame_coherence:
        return None
    boxes = [grid for volume, grid in zip(scene.volumes, grids, strict=True) if volume.interpolation == "nearest"]
    juts = max((math.hypot(*grid.spacing) for grid in boxes), default=0.0)
    return BULGE + math.ceil(juts / step_world)
