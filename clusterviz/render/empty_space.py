"""Empty-space skipping: the small groups of cells that contribute nothing to the picture.

A group is skipped only if the blend mode hides the whole range of its samples, including those on its far faces: with
most blend modes, if the transfer function is fully transparent there. So only zeros are left out, and pictures are the
same. The ranges depend on the voxels alone and are kept, so a new transfer function does not need the voxels.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.blend_mode import BlendMode
from clusterviz.plan.plan import Plan
from clusterviz.render.storage import GROUP, Slot
from clusterviz.scene.transfer import TransferFunction

Ranges = tuple[NDArray[Any], NDArray[Any]]


def group_ranges(voxels: NDArray[Any], slot: Slot) -> Ranges:
    """Return the smallest and largest finite sample of each group of cells of a brick.

    Parameters
    ----------
    voxels : (z, y, x), the brick's samples, including the slot's margin; may be smaller than the slot

    Returns
    -------
    low, high : of the voxels' dtype, `slot.groups_zyx`; a group without a finite sample has low > high or NaN
    """
    if voxels.dtype.kind == "f":
        voxels = np.where(np.isfinite(voxels), voxels, np.nan)
    return _reduced(voxels, slot, np.fmin), _reduced(voxels, slot, np.fmax)


def visible_groups(ranges: Ranges, plan: Plan) -> NDArray[np.bool_]:
    """Return the groups in which something may be visible.

    Parameters
    ----------
    ranges : low and high of n bricks, each (n, gz, gy, gx); of several volumes (n, volumes, gz, gy, gx)

    Returns
    -------
    visible : bool (n, gz, gy, gx)
    """
    low, high = ranges
    if plan.multi_volume is None:
        return _visible(low, high, plan.blend_mode, plan.transfer)
    each = enumerate(plan.multi_volume.volume_layers)
    visible = [_visible(low[:, n], high[:, n], part.blend_mode, part.transfer) for n, part in each]
    return np.asarray(np.any(visible, axis=0))


def visibility_bits(ranges: Ranges, plan: Plan, slot: Slot) -> NDArray[np.uint32]:
    """Return one bit for each group; 1 if something may be visible.

    Parameters
    ----------
    ranges : low and high of n bricks, each (n, *slot.groups_zyx); of several volumes (n, volumes, *slot.groups_zyx)

    Returns
    -------
    words : uint32 (n, slot.visibility_words), x fastest, the lowest bit first
    """
    return packed_bits(visible_groups(ranges, plan), slot)


def packed_bits(flags: NDArray[np.bool_], slot: Slot) -> NDArray[np.uint32]:
    """Pack flags of the groups of n bricks, (n, *slot.groups_zyx), as `visibility_bits` does."""
    groups = flags.reshape(len(flags), -1)
    bits = np.zeros((len(groups), 32 * slot.visibility_words), np.uint8)
    bits[:, : groups.shape[1]] = groups
    return np.packbits(bits, axis=1, bitorder="little").view("<u4")


def _visible(
    low: NDArray[Any], high: NDArray[Any], blend_mode: BlendMode, transfer: TransferFunction
) -> NDArray[np.bool_]:
    low, high = low.astype(np.float64), high.astype(np.float64)
    # Ranges are widened by more than the rounding of the shader's float32.
    margin = 2.0**-20 * np.maximum(np.abs(low), np.abs(high))
    known = ~(np.isnan(low) | np.isnan(high))
    return np.asarray(known & ~blend_mode.hides(transfer, low - margin, high + margin))


def _reduced(voxels: NDArray[Any], slot: Slot, pick: np.ufunc) -> NDArray[Any]:
    """Reduce groups of GROUP cells, with GROUP + 1 samples and those of the kernel, along each axis in turn."""
    for axis, groups in enumerate(slot.groups_zyx):
        first, end = slot.margin, slot.margin + groups * GROUP
        samples = np.moveaxis(voxels, axis, 0)[: end + 1 + slot.spread]
        short = end + 1 + slot.spread - len(samples)
        if short > 0:
            samples = np.concatenate([samples, np.repeat(samples[-1:], short, axis=0)])
        found = pick.reduce(samples[first:end].reshape(groups, GROUP, *samples.shape[1:]), axis=1)
        for beside in (*range(-slot.spread, 0), *range(GROUP, GROUP + 1 + slot.spread)):
            found = pick(found, samples[first + beside : end + beside : GROUP])
        voxels = np.moveaxis(found, 0, axis)
    return voxels
