"""Clipping planes in index space, and the bricks that they hide."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.grid import Grid
from clusterviz.scene.values import Clip


def clip_planes(clip: Clip, grid: Grid) -> NDArray[np.float64]:
    """Return the clipping planes of a scene in index space, those of its box included.

    Returns
    -------
    planes : float64 (n, 4); a point p (x, y, z) in index space is kept where planes[:, :3] · p + planes[:, 3] ≥ 0
    """
    pairs = [(np.array(point), np.array(normal)) for point, normal in clip.planes]
    if clip.box is not None:
        for axis in range(3):
            for side, sign in ((0, 1.0), (1, -1.0)):
                point, normal = np.zeros(3), np.zeros(3)
                point[axis], normal[axis] = clip.box[2 * axis + side], sign
                pairs.append((point, normal))
    planes = np.zeros((len(pairs), 4))
    for row, (point, direction) in zip(planes, pairs, strict=True):
        unit = direction / np.abs(direction).max()
        row[:3] = grid.world_from_index[:3, :3].T @ unit
        row[3] = unit @ (np.array(grid.origin) - point)
    return planes


def clipped_bricks(planes: NDArray[np.float64], layout: BrickLayout) -> NDArray[np.bool_]:
    """Return the bricks, bool (bz, by, bx), that lie wholly on the clipped side of a plane."""
    edges = [borders.astype(np.float64) for borders in layout.borders_zyx]
    clipped = np.zeros(layout.counts_zyx, bool)
    for *normal, offset in planes.tolist():
        # The corner farthest on the kept side, with a tolerance for the rounding of the shader's own test.
        ahead = [np.maximum(n * edge[:-1], n * edge[1:]) for n, edge in zip(normal[::-1], edges, strict=True)]
        size = abs(offset) + sum(abs(n) * float(edge[-1]) for n, edge in zip(normal[::-1], edges, strict=True))
        most = ahead[0][:, None, None] + ahead[1][None, :, None] + ahead[2][None, None, :] + offset
        clipped |= most < -1e-12 * size
    return clipped
