"""Cost of bricks in a view: expected by a model, and corrected by the measured costs of ranks.

The model is the number of samples that rays take in each brick. A frame measures the cost of a rank, not of its bricks,
so the model distributes a rank's cost over them. For each brick a factor is kept: measured cost over modelled cost. The
model depends on the camera. The factor covers what does not, such as the empty part of a brick, so it stays valid when
the camera jumps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import UNASSIGNED, Owners
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import View
from clusterviz.report.statistics import RankFrame

POINTS_A_SIDE = 3  # points along each axis of a brick at which the density of samples is computed
BRICKS_AT_ONCE = 1024  # their points fit into a cache
LEAST = 1e-3  # least cost of a rank or brick, relative to the expected: it may come into view in the next frame
FRAMES = 16  # remembered frames: with different owners, each gives another equation for the same bricks
SWEEPS = 3  # over these frames, in each frame
SMOOTH = 6  # corrections are smoothed over 1/6 of the volume's sides, in both directions


def expected_samples(plan: Plan, rect: Rect | None = None) -> Costs:
    """Return the samples that rays take in each brick if they skip nothing.

    In perspective, pixels of width p are p · a apart at the distance a ahead of the eye. Slabs of length h are
    h · a / r apart along that axis, at the distance r from the eye. So the volume of a sample is p² a² · h a / r.

    Returns float64 (bz, by, bx); 0 for bricks that are not visible or outside `rect`. Within a few per cent of a count
    for bricks inside `rect`; a rough estimate for the brick that contains the eye.

    `rect`: pixels whose rays count; None: the whole picture.
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
    column, row = view.centre
    left, last = ((x - column) * view.pixel for x in (rect.x_begin, rect.x_end))
    bottom, top = ((row - y) * view.pixel for y in (rect.y_end, rect.y_begin))
    # The axes have unit length in the world: their determinant is cells per unit of volume.
    cell_world = 1 / abs(float(np.linalg.det(axes)))
    if view.parallel:
        seen = (left <= right) & (right < last) & (bottom < up) & (up <= top)
        return np.where(seen, cell_world / (view.pixel**2 * step_world), 0.0)
    # Close to the eye the density at a point has no bound, but the samples of a brick have.
    floor = near * cell_world ** (1 / 3) / 2
    depth = np.maximum(ahead, floor)
    across, along = right / depth, up / depth
    seen = (ahead > 0) & (left <= across) & (across < last) & (bottom < along) & (along <= top)
    squared = depth * depth
    distance = np.sqrt(squared + (right * right + up * up))
    return np.where(seen, cell_world / (view.pixel**2 * step_world) * distance / (squared * depth), 0.0)


@dataclass(frozen=True, eq=False)
class Frame:
    """Measurement of one frame."""

    owner: NDArray[np.int64]  # int64 (bz, by, bx), rank that drew each brick, counted from 1; 0 for bricks out of view
    model: Costs  # float64 (bz, by, bx), modelled cost of each brick; 0 for bricks out of view
    costs: NDArray[np.float64]  # float64 (ranks,), measured cost of each rank


@dataclass(frozen=True, eq=False)
class Measured:
    """Cost factors of the bricks."""

    factor: NDArray[np.float64]  # float64 (bz, by, bx), measured cost over modelled cost, up to a common factor
    frames: tuple[Frame, ...] = ()  # that were measured, the last `FRAMES` with any cost


def unmeasured(shape_zyx: tuple[int, int, int]) -> Measured:
    """Return factors of 1, as before the first frame."""
    return Measured(np.ones(shape_zyx))


def rank_costs(per_rank: Sequence[RankFrame]) -> NDArray[np.float64]:
    """Return the samples of a frame on each rank, float64 (ranks,); seconds would differ from run to run."""
    return np.array([rank.samples for rank in per_rank], np.float64)


def measure(past: Measured, model: Costs, owners: Owners, costs: NDArray[np.float64]) -> Measured:
    """Learn from one frame.

    The factors of a rank's bricks are multiplied by the rank's measured cost over its expected cost. Cost seldom jumps
    at the planes of a tree, so these ratios are first smoothed across ranks. Then the sums of the remembered frames are
    corrected frame by frame, the newest last. This separates bricks whose owner has changed. Factors of bricks out of
    view stay, and frames without cost are ignored.

    Parameters
    ----------
    model : float64 (bz, by, bx), modelled cost in this frame, such as `expected_samples`
    costs : float64 (ranks,), as `rank_costs` returns them

    References
    ----------
    R. Gordon, R. Bender, G. Herman: Algebraic reconstruction techniques, Journal of Theoretical Biology 29, 1970 (the
    multiplicative form, with the ranks of a frame in place of the rays of a view).
    """
    drawn = (model > 0) & (owners.owner != UNASSIGNED)
    frame = Frame(np.where(drawn, owners.owner + 1, 0).astype(np.int64), np.where(drawn, model, 0.0), costs)
    ratio = _ratio(frame, past.factor)
    if ratio is None:
        return past
    factor = past.factor * np.exp(_smooth(np.log(ratio)))
    frames = (*past.frames, frame)[-FRAMES:]
    for _ in range(SWEEPS):
        for each in frames:
            ratio = _ratio(each, factor)
            if ratio is not None:
                factor = factor * ratio
    return Measured(factor / factor[drawn].mean(), frames)


def predict(measured: Measured, model: Costs, shown: NDArray[np.bool_]) -> Costs:
    """Return the expected cost of each brick in a frame.

    Returns float64 (bz, by, bx); above 0 exactly where `shown`, also out of view: such bricks may come into view, so
    they are spread over the ranks too.

    Parameters
    ----------
    model : float64 (bz, by, bx), modelled cost in that frame
    shown : bool (bz, by, bx), visible bricks
    """
    cost = model * measured.factor
    mean = float(cost[shown].mean()) if shown.any() else 0.0
    return np.where(shown, np.maximum(cost, LEAST * mean if mean > 0 else 1.0), 0.0)


def _ratio(frame: Frame, factor: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Measured over expected cost of each brick's rank; 1 for bricks not drawn; None for a frame without cost."""
    # Called for many frames with few bricks: the number of arrays determines the time.
    expected = np.bincount(frame.owner.ravel(), (frame.model * factor).ravel(), minlength=len(frame.costs) + 1)[1:]
    counts = expected > 0
    total = float(frame.costs @ counts)
    if total <= 0:
        return None
    ratio = np.ones(len(expected) + 1)
    # In units of the frame's own mean, so that a slow frame does not make its bricks expensive.
    np.divide(frame.costs * (float(expected.sum()) / total), expected, out=ratio[1:], where=counts)
    return np.maximum(LEAST, ratio)[frame.owner]


def _smooth(field: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth by two box filters, nearly a Gaussian, that reach 1/`SMOOTH` of the volume's sides in each direction."""
    for axis, bricks in enumerate(field.shape):
        reach = bricks // SMOOTH
        for _ in range(2):
            padded = np.pad(field, [(reach + 1, reach) if other == axis else (0, 0) for other in range(3)], mode="edge")
            sums = np.moveaxis(np.cumsum(padded, axis), axis, 0)
            width = 2 * reach + 1
            field = np.moveaxis((sums[width:] - sums[:bricks]) / width, 0, axis)
    return field
