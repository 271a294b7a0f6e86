"""How far rays may skip over groups of cells that have nothing to show.

A group that is c groups away from the nearest visible one, along the axis where it is farthest, lies in the middle of a
cube of 2c − 1 groups a side without anything visible. Rays skip to the end of that cube.

References
----------
D. Cohen, Z. Sheffer: Proximity clouds - an acceleration technique for 3D grid traversal, The Visual Computer 11, 1994.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.render.storage import GROUP

FARTHEST = 16  # groups
WHOLE_BRICK = -1
Index = tuple[int, int, int]


def skips_of(visible: NDArray[np.bool_], places: NDArray[np.intp], shape_zyx: Index, brick: int) -> NDArray[np.int32]:
    """Return how far rays may skip from each group of cells.

    Parameters
    ----------
    visible : bool (n, gz, gy, gx), the groups of stored bricks
    places : int (n, 3), where these lie in their box
    shape_zyx : bricks of the box
    brick : cells along the side of a brick

    Returns
    -------
    skips : int32 (*shape_zyx, gz, gy, gx): 0 where something may be visible; else how many groups from here, along
        every axis, rays may skip, or WHOLE_BRICK
    """
    groups = visible.shape[1:]
    if brick % GROUP:
        # Groups are not all of one size, so none is counted on but the ray's own.
        skips = np.full((*shape_zyx, *groups), WHOLE_BRICK, np.int32)
        skips[tuple(places.T)] = np.where(visible, 0, 1)
        return skips
    shown = np.zeros((*shape_zyx, *groups), bool)
    shown[tuple(places.T)] = visible
    order = (0, 3, 1, 4, 2, 5)
    side_by_side = shown.transpose(order)
    found = distances(side_by_side.reshape([n * g for n, g in zip(shape_zyx, groups, strict=True)]))
    return np.ascontiguousarray(found.reshape(side_by_side.shape).transpose(np.argsort(order)))


def distances(shown: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the distance to the nearest one that is shown, at most FARTHEST."""
    found = np.full(shown.shape, FARTHEST, np.int32)
    found[shown] = 0
    grown = shown
    for distance in range(1, FARTHEST):
        if grown.all():
            break
        wider = _grown(grown)
        found[wider & ~grown] = distance
        grown = wider
    return found


def _grown(shown: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """With all neighbours, those at edges and corners too."""
    for axis in range(3):
        lines = np.moveaxis(shown, axis, 0)
        wider = lines.copy()
        wider[1:] |= lines[:-1]
        wider[:-1] |= lines[1:]
        shown = np.moveaxis(wider, 0, axis)
    return shown
