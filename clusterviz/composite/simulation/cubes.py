"""Footprints of a cube cut into one brick per rank, for the simulation of sparse images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.composite.schedules.rectangles import Rectangles

# View along the diagonal of the unit cube, from large coordinates. Rows: screen right, screen down.
SCREEN_FROM_WORLD = np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, -2.0]]) / np.sqrt([[2.0], [6.0]])


def cube_footprints(ranks: int, size: tuple[int, int]) -> Rectangles:
    """Return bounding rectangles of the bricks of a cube, front to back, in parallel projection along its diagonal.

    Parameters
    ----------
    ranks : number of bricks; boxes are halved across their longest side until there is one for each rank
    size : (width, height) of the picture; the cube touches its borders in at least one direction

    Returns
    -------
    footprints : rectangles on a canvas that is the union of all of them
    """
    boxes = _bricks(ranks)
    middle, half = (boxes[:, 0] + boxes[:, 1]) / 2, (boxes[:, 1] - boxes[:, 0]) / 2
    reach = np.abs(SCREEN_FROM_WORLD).sum(axis=1)
    scale = min(size[0] / reach[0], size[1] / reach[1])
    centre = ((middle - 0.5) @ SCREEN_FROM_WORLD.T) * scale + np.array(size) / 2
    spread = half @ np.abs(SCREEN_FROM_WORLD).T * scale
    begin = np.clip(np.floor(centre - spread + 1e-9).astype(np.int64), 0, np.array(size) - 1)
    end = np.clip(np.ceil(centre + spread - 1e-9).astype(np.int64), begin + 1, size)
    corner = begin.min(axis=0)
    width, height = (int(side) for side in end.max(axis=0) - corner)
    begin, end = begin - corner, end - corner
    whole = np.zeros(ranks, np.int64), np.full(ranks, width * height, np.int64)
    return Rectangles(width, height, *whole, begin[:, 0], begin[:, 1], end[:, 0], end[:, 1])


def _bricks(ranks: int) -> NDArray[np.float64]:
    """Return boxes (ranks, 2, 3) in the unit cube, front to back."""
    found = []
    waiting: list[tuple[int, tuple[float, ...], tuple[float, ...]]] = [(ranks, (0.0,) * 3, (1.0,) * 3)]
    while waiting:
        count, low, high = waiting.pop()
        if count == 1:
            found.append((low, high))
            continue
        axis = max(range(3), key=lambda i: high[i] - low[i])
        near = count // 2
        border = high[axis] - (high[axis] - low[axis]) * near / count
        waiting.append((count - near, low, (*high[:axis], border, *high[axis + 1 :])))
        waiting.append((near, (*low[:axis], border, *low[axis + 1 :]), high))
    return np.array(found)
