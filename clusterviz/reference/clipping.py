"""Reference of clipping by planes and a box, in the world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.reference.rays import Floats
from clusterviz.scene.values import Clip


def kept(point: Floats, clip: Clip, grid: Grid) -> NDArray[np.bool_]:
    """Return which points are not clipped, bool (n,).

    Parameters
    ----------
    point : float64 (n, 3), (x, y, z) in samples
    """
    world = point @ grid.world_from_index[:3, :3].T + grid.origin
    found = np.ones(len(world), bool)
    for origin, normal in clip.planes:
        found &= (world - origin) @ np.array(normal) >= 0
    if clip.box is not None:
        low, high = np.reshape(clip.box, (3, 2)).T
        found &= ((world >= low) & (world <= high)).all(axis=1)
    return found
