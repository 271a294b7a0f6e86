"""Encoded brick with what is known of its groups of cells, as ray casters load it and ranks send it.

Empty-space skipping leaves out groups that contribute nothing. A group is skipped only if the blend mode hides the
whole range of its samples, including those on its far faces: with most blend modes, if the transfer function is fully
transparent there. So only zeros are left out, and pictures are the same. The ranges depend on the voxels alone and are
kept, so a new transfer function does not need the voxels. For the adaptive step, steepness and bend of the field in a
group give the length of its slabs.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.plan.blend_mode import BlendMode
from clusterviz.plan.domain import Cut
from clusterviz.plan.geometry import Members
from clusterviz.plan.plan import Plan
from clusterviz.render.storage import GROUP, Slot, slot_of
from clusterviz.scene.transfer import TransferFunction


@dataclass(frozen=True, eq=False)
class Part:
    """Samples of one volume in a brick.

    Attributes
    ----------
    samples : uint8, uint16 or float32 (z, y, x), encoded by `Encoding.encode`, at most as many as its slot has
    first_xyz : of mixed content, cell of the volume at the first sample inside the slot's margin
    level : of the volume, whose cells and samples these are
    cells_xyz : cells of the brick; of interest with levels only
    """

    samples: NDArray[Any]
    first_xyz: tuple[int, ...] = (0, 0, 0)
    level: int = 0
    cells_xyz: tuple[int, ...] = (0, 0, 0)

    @staticmethod
    def of(samples: NDArray[Any], cut: Cut, index_zyx: Index) -> Part:
        """Return the encoded samples of a brick that a cut, of a level, has."""
        begin, end = cut.cell_box(index_zyx)
        return Part(samples, begin[::-1], cut.level, tuple(e - b for b, e in zip(begin, end, strict=True))[::-1])

    def slot(self, slot: Slot) -> Slot:
        """Return the slot of these samples alone, if the slot of the volume's bricks is given."""
        return replace(slot, cells_zyx=self.cells_xyz[::-1]) if slot.has_levels else slot  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Stored:
    """Encoded brick.

    Attributes
    ----------
    parts : samples of each volume; None where it has none
    low, high : smallest and largest finite sample of its groups of cells, float64 (volumes, gz, gy, gx), as of
        `ranges_of`
    voxels : number of samples before encoding
    bend : result of `group_curvature`; None without an adaptive step
    members : as in `ContentBrick`
    """

    parts: Sequence[Part | None]
    low: NDArray[Any]
    high: NDArray[Any]
    voxels: int
    bend: NDArray[np.float32] | None = None
    members: tuple[Members | None, ...] = ()


def stamp_of(plan: Plan, brick: Index | None = None) -> int:
    """Return a checksum of the format and time steps of a plan's bricks; with a brick its levels count, too.

    Bricks with another one do not suit the plan.
    """
    levels = plan.content.levels_around(brick) if brick else ()
    stored = slot_of(plan), plan.content.encodings, plan.content.reach, plan.times
    return zlib.crc32(repr((stored, levels)).encode())


Ranges = tuple[NDArray[Any], NDArray[Any]]
"""Smallest and largest samples in groups of cells, float64 (volumes, gz, gy, gx) each; of n bricks (n, volumes, …)."""


def group_ranges(voxels: NDArray[Any], slot: Slot, group: int = GROUP) -> Ranges:
    """Return the smallest and largest finite sample of each group of cells of a brick.

    Parameters
    ----------
    voxels : (z, y, x), the brick's samples, including the slot's margin; may be smaller than the slot
    group : cells along the side of a group

    Returns
    -------
    low, high : float64, for groups of `GROUP` cells `slot.groups_zyx`; a group without a finite sample has NaN
    """
    if voxels.dtype.kind == "f":
        voxels = np.where(np.isfinite(voxels), voxels, np.nan)
    low, high = (_reduced(voxels, slot, pick, group).astype(np.float64) for pick in (np.fmin, np.fmax))
    return low, high


def visible_groups(ranges: Ranges, plan: Plan) -> NDArray[np.bool_]:
    """Return the groups of n bricks in which something may be visible, bool (n, gz, gy, gx)."""
    low, high = ranges
    each = enumerate(plan.content.volume_layers)
    visible = [_visible(low[:, n], high[:, n], part.blend_mode, part.transfer) for n, part in each]
    return np.asarray(np.any(visible, axis=0))


def visibility_bits(ranges: Ranges, plan: Plan, slot: Slot) -> NDArray[np.uint32]:
    """Return one bit for each group of n bricks, 1 if something may be visible.

    They are uint32 (n, slot.visibility_words), x fastest, the lowest bit first.
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
    # Ranges are widened by more than the rounding of the shader's float32.
    margin = 2.0**-20 * np.maximum(np.abs(low), np.abs(high))
    known = ~(np.isnan(low) | np.isnan(high))
    return np.asarray(known & ~blend_mode.hides(transfer, low - margin, high + margin))


def _reduced(voxels: NDArray[Any], slot: Slot, pick: np.ufunc, group: int) -> NDArray[Any]:
    """Reduce groups of cells, with a sample more than cells and those of the kernel, along each axis in turn."""
    for axis, cells in enumerate(slot.cells_zyx):
        groups = -(-cells // group)
        before, first, end = (slice(None),) * axis, slot.margin, slot.margin + groups * group
        samples = voxels[(*before, slice(end + 1 + slot.spread))]
        short = end + 1 + slot.spread - samples.shape[axis]
        if short > 0:
            samples = np.concatenate([samples, np.repeat(samples[(*before, slice(-1, None))], short, axis)], axis)
        sides = *voxels.shape[:axis], groups, group, *voxels.shape[axis + 1 :]
        found = pick.reduce(samples[(*before, slice(first, end))].reshape(sides), axis=axis + 1)
        for beside in (*range(-slot.spread, 0), *range(group, group + 1 + slot.spread)):
            pick(found, samples[(*before, slice(first + beside, end + beside, group))], out=found)
        voxels = found
    return voxels


def group_curvature(voxels: NDArray[Any], slot: Slot) -> NDArray[np.float32]:
    """Return steepness and bend of the field in each group of cells of a brick, as of `group_ranges`.

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
    """Return how often the slabs of groups are doubled, (n, *slot.groups_zyx), by results of `group_curvature`."""
    assert plan.march.adaptive_step is not None, "the step is fixed"
    known = (values.astype(np.float64).ravel() for values in (*ranges, bends[:, 0], bends[:, 1]))
    return plan.march.adaptive_step.doublings(plan.volume.transfer, *known).reshape(bends[:, 0].shape)


def doubling_bits(ranges: Ranges, bends: NDArray[np.float32], plan: Plan, slot: Slot) -> NDArray[np.uint32]:
    """Return two bits for each group, its doublings: uint32 (n, 2 * slot.visibility_words), low bits first."""
    doublings = group_doublings(ranges, bends, plan)
    return np.concatenate([packed_bits((doublings >> bit & 1).astype(bool), slot) for bit in (0, 1)], axis=1)
