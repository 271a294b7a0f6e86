"""Expected cost of bricks in a view: the number of samples that rays take in each.

A frame measures the cost of a rank, not of its bricks. This model distributes a rank's cost over its bricks, and
carries measurements to another camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.region import Rect
from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import View

POINTS_A_SIDE = 3  # points along each axis of a brick at which the density of samples is computed
BRICKS_AT_ONCE = 1024  # their points fit into a cache


def expected_samples(plan: Plan, rect: Rect | None = None) -> Costs:
    """Return the samples that rays take in each brick if they skip nothing.

    In perspective, pixels of width p are p · a apart at the distance a ahead of the eye. Slabs of length h are
    h · a / r apart along that axis, at the distance r from the eye. So the volume of a sample is p² a² · h a / r.

    Parameters
    ----------
    plan : of one frame
    rect : pixels whose rays count; None: the whole picture

    Returns
    -------
    cost : float64 (bz, by, bx); 0 for bricks that are not visible or outside `rect`. Within a few per cent of a count
        for bricks inside `rect`; a rough estimate for the brick that contains the eye
    """
    rect = rect or Rect(0, 0, *plan.view.size)
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
    for first in range(0, len(bricks), BRICKS_AT_ONCE):
        some = slice(first, first + BRICKS_AT_ONCE)
        points = (begin[some] + extent[some] * offset)[..., ::-1].reshape(-1, 3)
        each = _samples_per_cell(plan.view, rect, points, near, plan.march.step_world)
        density[some] = each.reshape(len(offset), -1).mean(axis=0)
    cost[tuple(bricks.T)] = plan.cost[tuple(bricks.T)] * density
    return cost


def _samples_per_cell(
    view: View, rect: Rect, points: NDArray[np.float64], near: float, step_world: float
) -> NDArray[np.float64]:
    """Samples per cell around each point (n, 3) in index space; 0 if no pixel of `rect` sees it."""
    axes = np.array([view.right, view.up, view.forward]).T
    right, up, ahead = np.linalg.solve(axes, (points - np.array(view.eye)).T)
    width, height = view.size
    left, last = ((x - width / 2) * view.pixel for x in (rect.x_begin, rect.x_end))
    bottom, top = ((height / 2 - y) * view.pixel for y in (rect.y_end, rect.y_begin))
    # The axes have unit length in the world: their determinant is cells per unit of volume.
    cell_world = 1 / abs(float(np.linalg.det(axes)))
    if view.parallel:
        seen = (left <= right) & (right <= last) & (bottom <= up) & (up <= top)
        return np.where(seen, cell_world / (view.pixel**2 * step_world), 0.0)
    # Close to the eye the density at a point has no bound, but the samples of a brick have.
    floor = near * cell_world ** (1 / 3) / 2
    depth = np.maximum(ahead, floor)
    across, along = right / depth, up / depth
    seen = (ahead > 0) & (left <= across) & (across <= last) & (bottom <= along) & (along <= top)
    squared = depth * depth
    distance = np.sqrt(squared + (right * right + up * up))
    return np.where(seen, cell_world / (view.pixel**2 * step_world) * distance / (squared * depth), 0.0)
