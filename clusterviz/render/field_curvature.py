"""Steepness and bend of the field in groups of cells, and the lengths of slabs that follow (adaptive step)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.plan import Plan
from clusterviz.render.empty_space import Ranges, packed_bits
from clusterviz.render.storage import GROUP, Slot


def group_curvature(voxels: NDArray[Any], slot: Slot) -> NDArray[np.float32]:
    """Return steepness and bend of the field in each group of cells of a brick.

    Parameters
    ----------
    voxels : as in `group_ranges`

    Returns
    -------
    bends : float32, (2, *slot.groups_zyx), in data values; NaN where a sample has none. First the largest change of the
        field over a voxel's length; then the largest second difference of samples, along an axis or mixed. Those along
        an axis count inside the group, where a line through it has a kink, not on its faces.
    """
    z, y, x = (slice(slot.margin, slot.margin + cells + 1) for cells in slot.cells_zyx)
    inside = voxels[z, y, x].astype(np.float32)
    worst = np.zeros(np.subtract(inside.shape, 1), np.float32)
    squares = np.zeros_like(_grouped(worst))
    for axis, others in enumerate(((1, 2), (0, 2), (0, 1))):
        steps = np.diff(inside, axis=axis)
        squares += _grouped(_beside(_beside(np.abs(steps), others[0]), others[1])) ** 2
        kinks = np.moveaxis(np.abs(np.diff(steps, axis=axis, prepend=np.float32(0))), axis, 0)
        kinks[::GROUP] = 0
        worst = np.maximum(worst, _beside(_beside(np.moveaxis(kinks, 0, axis), others[0]), others[1]))
        worst = np.maximum(worst, _beside(np.abs(np.diff(np.diff(inside, axis=others[0]), axis=others[1])), axis))
    found = np.stack([np.sqrt(squares), _grouped(worst)])
    missing = np.subtract(slot.groups_zyx, found.shape[1:])
    return np.pad(found, [(0, 0), *((0, int(n)) for n in missing)])


def _grouped(cells: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the largest value of each group of cells."""
    padded = np.pad(cells, [(0, -n % GROUP) for n in cells.shape])
    found: NDArray[np.float32] = padded.reshape([n for side in padded.shape for n in (side // GROUP, GROUP)]).max(
        (1, 3, 5)
    )
    return found


def _beside(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """Return the larger of neighbours along an axis: from samples to cells."""
    values = np.moveaxis(values, axis, 0)
    return np.moveaxis(np.maximum(values[:-1], values[1:]), 0, axis)


def group_doublings(ranges: Ranges, bends: NDArray[np.float32], plan: Plan) -> NDArray[np.uint8]:
    """Return how often the slabs of groups are doubled, (n, *slot.groups_zyx).

    Parameters
    ----------
    ranges : low and high of n bricks, each (n, *slot.groups_zyx)
    bends : results of `group_curvature`, (n, 2, *slot.groups_zyx)
    """
    assert plan.march.stretching is not None, "nothing is stretched"
    known = (values.astype(np.float64).ravel() for values in (*ranges, bends[:, 0], bends[:, 1]))
    return plan.march.stretching.doublings(plan.transfer, *known).reshape(ranges[0].shape)


def stretch_bits(ranges: Ranges, bends: NDArray[np.float32], plan: Plan, slot: Slot) -> NDArray[np.uint32]:
    """Return two bits for each group, its doublings: uint32 (n, 2 * slot.visibility_words), low bits first.

    Parameters
    ----------
    ranges, bends : as in `group_doublings`
    """
    doublings = group_doublings(ranges, bends, plan)
    return np.concatenate([packed_bits((doublings >> bit & 1).astype(bool), slot) for bit in (0, 1)], axis=1)
