"""What bricks should cost in a view before anything was drawn: the samples that rays take in each.

A frame measures a rank, not its bricks. The model says how a rank's cost is spread over its bricks, and carries what
was measured to another camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.region import Rect
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import View

POINTS_A_SIDE = 3  # of each brick, at which the density of samples is looked up
AT_ONCE = 1024  # bricks, whose points fill a cache


def expected_samples(plan: Plan, window: Rect | None = None) -> Costs:
    """Samples that rays take in each brick if they skip nothing.

    In perspective, pixels of width p lie p · a apart at the distance a ahead of the eye, and slabs of length h lie
    h · a / r apart along that axis, r from the eye: a sample stands for p² a² · h a / r of the world.

    Parameters
    ----------
    plan : of one frame
    window : the pixels whose rays count; None: all of the picture

    Returns
    -------
    cost : float64 (bz, by, bx); 0 for bricks that have nothing to show, and for those out of the window. Within a few
        per cent of a count for bricks inside the window; a brick that the eye is in is only roughly right
    """
    window = window or Rect(0, 0, *plan.view.size)
    cost = np.zeros(plan.cost.shape)
    bricks = np.argwhere(plan.cost > 0)
    if len(bricks) == 0:
        return cost
    begin, extent = (
        np.stack([part[at] for part, at in zip(parts, bricks.T, strict=True)], axis=1)
        for parts in (plan.layout.borders_zyx, plan.layout.sides_zyx)
    )
    near = float(extent.max()) / 2
    offsets = (np.arange(POINTS_A_SIDE) + 0.5) / POINTS_A_SIDE
    offset = np.stack(np.meshgrid(offsets, offsets, offsets, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    density = np.empty(len(bricks))
    for first in range(0, len(bricks), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        points = (begin[some] + extent[some] * offset)[..., ::-1].reshape(-1, 3)
        each = _samples_per_cell(plan.view, window, points, near, plan.march.step_world)
        density[some] = each.reshape(len(offset), -1).mean(axis=0)
    cost[tuple(bricks.T)] = plan.cost[tuple(bricks.T)] * density
    return cost


def _samples_per_cell(
    view: View, window: Rect, points: NDArray[np.float64], near: float, step_world: float
) -> NDArray[np.float64]:
    """Samples per cell around each point (n, 3) in index space; 0 where no pixel of the window sees it."""
    axes = np.array([view.right, view.up, view.forward]).T
    right, up, ahead = np.linalg.solve(axes, (points - np.array(view.eye)).T)
    width, height = view.size
    left, last = ((x - width / 2) * view.pixel for x in (window.x_begin, window.x_end))
    bottom, top = ((height / 2 - y) * view.pixel for y in (window.y_end, window.y_begin))
    # The axes have unit length in the world: their determinant is cells per unit of volume.
    cell_world = 1 / abs(float(np.linalg.det(axes)))
    if view.parallel:
        seen = (left <= right) & (right <= last) & (bottom <= up) & (up <= top)
        return np.where(seen, cell_world / (view.pixel**2 * step_world), 0.0)
    # Nearer than the point's own surroundings, density grows without end, and the samples of the brick do not.
    floor = near * cell_world ** (1 / 3) / 2
    depth = np.maximum(ahead, floor)
    across, along = right / depth, up / depth
    seen = (ahead > 0) & (left <= across) & (across <= last) & (bottom <= along) & (along <= top)
    squared = depth * depth
    distance = np.sqrt(squared + (right * right + up * up))
    return np.where(seen, cell_world / (view.pixel**2 * step_world) * distance / (squared * depth), 0.0)
