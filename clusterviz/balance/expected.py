"""What bricks should cost in a view before anything was drawn: the samples that rays take in each.

A frame measures a rank, not its bricks. The model says how a rank's cost is spread over its bricks, and carries what
was measured to another camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.bsp import Costs
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import View

POINTS_A_SIDE = 3  # of each brick, at which the density of samples is looked up


def expected_samples(plan: Plan) -> Costs:
    """Samples that rays take in each brick if they skip nothing.

    In perspective, pixels of width p lie p · a apart at the distance a ahead of the eye, and slabs of length h lie
    h · a / r apart along that axis, r from the eye: a sample stands for p² a² · h a / r of the world.

    Parameters
    ----------
    plan : of one frame

    Returns
    -------
    cost : float64 (bz, by, bx); 0 for bricks that have nothing to show, and for those out of the picture. Within a few
        per cent of a count for bricks inside the picture; a brick that the eye is in is only roughly right
    """
    cost = np.zeros(plan.cost.shape)
    bricks = np.argwhere(plan.cost > 0)
    if len(bricks) == 0:
        return cost
    side = plan.layout.brick
    begin = bricks * side
    extent = np.minimum(side, np.array(plan.layout.cells_zyx) - begin)
    density = np.zeros(len(bricks))
    offsets = (np.arange(POINTS_A_SIDE) + 0.5) / POINTS_A_SIDE
    for z in offsets:
        for y in offsets:
            for x in offsets:
                points = (begin + extent * np.array([z, y, x]))[:, ::-1]
                density += _samples_per_cell(plan.view, points, float(extent.max()) / 2, plan.march.step_world)
    cost[tuple(bricks.T)] = plan.cost[tuple(bricks.T)] * density / POINTS_A_SIDE**3
    return cost


def _samples_per_cell(view: View, points: NDArray[np.float64], near: float, step_world: float) -> NDArray[np.float64]:
    """Samples per cell around each point (n, 3) in index space; 0 where no pixel sees it."""
    axes = np.array([view.right, view.up, view.forward]).T
    coordinates = np.linalg.solve(axes, (points - np.array(view.eye)).T).T
    aside, ahead = coordinates[:, :2], coordinates[:, 2]
    half = np.array(view.size) * view.pixel / 2
    # The axes have unit length in the world: their determinant is cells per unit of volume.
    cell_world = 1 / abs(float(np.linalg.det(axes)))
    if view.parallel:
        seen = (np.abs(aside) <= half).all(axis=1)
        return np.where(seen, cell_world / (view.pixel**2 * step_world), 0.0)
    # Nearer than the point's own surroundings, density grows without end, and the samples of the brick do not.
    floor = near * cell_world ** (1 / 3) / 2
    depth = np.maximum(ahead, floor)
    seen = (ahead > 0) & (np.abs(aside) <= half * depth[:, None]).all(axis=1)
    distance = np.sqrt(depth**2 + (aside**2).sum(axis=1))
    return np.where(seen, cell_world * distance / (view.pixel**2 * step_world * depth**3), 0.0)
