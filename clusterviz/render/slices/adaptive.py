"""Adaptive sampling in three dimensions: the pyramidal lock-step algorithm over view-aligned slices.

All rays take slice after slice together. An oracle says how far apart samples may be around a point; samples are left
out along rays, and beside each other where a coarser level of a pyramid over the pixels has them already: skipped ones
are synthesized from it by the filter of Doo and Sabin. On slice k, level l is updated if 2^l divides k. Slabs reach
from one sample of a pixel to its next, with integrals of the transfer function over the scalars between.

When to use: samples that are expensive, and volumes that are empty or uniform for the most part. When not: with
samples as cheap as those of a grid in memory, steps along rays (`quality.adaptive`, empty-space skipping) win, since a
synthesized sample costs four fetches of the pyramid.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 4.3.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.jobs.kernel import kernel
from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.plan.plan import Plan
from clusterviz.plan.sampling_oracle import SamplingOracle
from clusterviz.scene.transfer import TransferFunction

COARSEST = 4
"""Levels above that of the pixels: at most every 16th ray and slice is sampled."""
BINS = 4096
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class AdaptivePicture:
    """Picture of adaptively sampled slices.

    Attributes
    ----------
    rgba : float32 (h, w, 4), premultiplied
    samples : taken in the volume, by level, the pixels' own first
    uniform : samples that all rays would take
    """

    rgba: Floats
    samples: tuple[int, ...]
    uniform: int

    @property
    def share(self) -> float:
        """Samples over those of all rays."""
        return sum(self.samples) / max(1, self.uniform)


@kernel(
    "adaptive_level.glsl",
    writes=("finer", "passed", "rgba", "samples"),
    vectors=("finer", "coarser", "passed", "rgba", "spans", "table"),
)
def advance_level(
    voxels: Any,
    distances: Any,
    finer: Any,
    coarser: Any,
    passed: Any,
    rgba: Any,
    samples: Any,
    spans: Any,
    table: Any,
    eye: Any,
    right: Any,
    up: Any,
    forward: Any,
    lens: Any,
    domain: Any,
    levels: Any,
    slice: float,
    depth: float,
    units: float,
    per_block: float,
    per_distance: float,
) -> None:
    """Update a level of the pyramid on one slice."""


def draw_adaptively(
    plan: Plan, voxels: NDArray[Any], oracle: SamplingOracle, coarsest: int = COARSEST, along_rays: bool = False
) -> AdaptivePicture:
    """Return the picture of a whole volume.

    Parameters
    ----------
    plan : of one composited volume without light or clipping, with `quality.renderer: slices`
    voxels : (z, y, x), finite
    oracle : of the same volume; distances that are not numbers, or too short, are 1
    coarsest : the coarsest level; 0: all samples are taken
    along_rays : samples are left out along rays only, and none are synthesized

    Raises
    ------
    InputError
        The plan shows something else, or the voxels are not its volume, or not finite.
    """
    _check(plan, voxels)
    view, planes = plan.view, plan.slice_planes
    width, height = view.size
    spans, uniform = _spans(plan)
    domain = plan.volume.transfer.domain
    field = in_units_of_clim(voxels.astype(np.float64), *domain).astype(np.float32)
    sides = [(-(-height // 2**level), -(-width // 2**level)) for level in range(coarsest + 1)]
    pyramid = [np.zeros((*side, 2), np.float32) for side in sides]
    samples = [np.zeros(side, np.int32) for side in sides]
    passed = np.zeros((height, width, 2), np.float32)
    passed[..., 1] = -1.0
    rgba = np.zeros((height, width, 4), np.float32)
    table, low, per_bin = _table(plan.volume.transfer)
    # A distance of 1 is that of planes or of rays, whichever is longer, anywhere in the volume.
    cell = _cell_world(plan)
    farthest = 1.0 if view.parallel else (planes.first + _count(plan)) * planes.distance
    unit = max(planes.distance, view.pixel * farthest)
    distances = oracle.distances * np.float32(cell / unit)
    camera = (view.eye, view.right, view.up, view.forward)
    lens = (view.pixel, *view.centre, float(view.parallel))
    for number in range(-(-_count(plan) >> coarsest << coarsest) + 1):
        depth = (planes.first + number + 0.5) * planes.distance
        level_of_slice = min(coarsest, (number & -number).bit_length() - 1 if number else coarsest)
        for level in (0,) if along_rays else range(level_of_slice, -1, -1):
            coarser = pyramid[level + 1] if level < coarsest and not along_rays else np.zeros((1, 1, 2), np.float32)
            advance_level[sides[level]](
                *(field, distances, pyramid[level], coarser, passed, rgba),
                *(
                    samples[level],
                    spans,
                    table,
                    *camera,
                    lens,
                    (low, per_bin),
                    (level, level_of_slice, coarsest, int(along_rays)),
                ),
                *(
                    float(number),
                    depth,
                    planes.distance / plan.volume.transfer.unit_distance,
                    1 / oracle.block,
                    cell / unit,
                ),
            )
    return AdaptivePicture(rgba, tuple(int(each.sum()) for each in samples), uniform)


def _check(plan: Plan, voxels: NDArray[Any]) -> None:
    """Refuse what is not one composited volume on slices."""
    mode = plan.blend_mode
    problems = {
        "several volumes or geometry": plan.content.mixed,
        f"blending: {mode.blending}": not mode.traits.absorbs,
        "light, isosurfaces or opacity by the gradient": bool(mode.shading or mode.surfaces or mode.grading),
        "clipping planes": len(plan.clip) > 0,
        "rays": plan.march.lattice != "slices",
    }
    for name, is_one in problems.items():
        if is_one:
            allowed = "one composited volume with quality.renderer: slices"
            raise InputError("not sampled adaptively", where="adaptive slices", found=name, allowed=allowed)
    if voxels.shape != plan.layout.shape_zyx or not np.isfinite(voxels).all():
        found = f"{voxels.shape}, {np.count_nonzero(~np.isfinite(voxels))} of them not finite"
        raise InputError("wrong voxels", where="adaptive slices", found=found, allowed=plan.layout.shape_zyx)


def _count(plan: Plan) -> int:
    """Return the number of slices of the volume."""
    corners = np.array(np.meshgrid(*((0.0, length) for length in plan.extent))).reshape(3, -1).T
    return math.ceil(float(plan.view.depths(corners).max()) / plan.slice_planes.distance - plan.slice_planes.first)


def _cell_world(plan: Plan) -> float:
    """Return the shortest side of a cell in world units."""
    axes = np.array([plan.view.right, plan.view.up, plan.view.forward])  # a world unit each, in index space
    return float(1 / np.abs(np.linalg.svd(axes)[1]).max())


def _spans(plan: Plan) -> tuple[Floats, int]:
    """Return entry and exit of each pixel's ray in slices, plane k at k, float32 (h, w, 2); and the samples between."""
    view, planes = plan.view, plan.slice_planes
    width, height = view.size
    across, above = np.meshgrid(
        (np.arange(width) + 0.5 - view.centre[0]) * view.pixel, (view.centre[1] - np.arange(height) - 0.5) * view.pixel
    )
    aside = across[..., None] * np.array(view.right) + above[..., None] * np.array(view.up)
    start = np.array(view.eye) + aside * view.parallel
    way = np.broadcast_to(np.array(view.forward) + aside * (not view.parallel), start.shape)
    start = np.broadcast_to(start, way.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([-start / way, (np.array(plan.extent) - start) / way])
    along, between = way == 0, (start >= 0) & (start <= np.array(plan.extent))
    near = np.where(along, np.where(between, -np.inf, np.inf), ends.min(axis=0)).max(axis=-1)
    far = np.where(along, np.where(between, np.inf, -np.inf), ends.max(axis=0)).min(axis=-1)
    found = np.stack([np.maximum(near, 0.0), far], axis=-1) / planes.distance - planes.first - 0.5
    meets = found[..., 0] < found[..., 1]
    found = np.where(meets[..., None], found, (1.0, 0.0))
    counts = np.where(meets, np.ceil(found[..., 1]) - np.ceil(found[..., 0]), 0)
    return np.ascontiguousarray(found, np.float32), int(counts.sum())


def _table(transfer: TransferFunction) -> tuple[Floats, float, float]:
    """Return integrals of extinction and emission per unit distance, and these, float32 (2, n, 4).

    Also the scalar of the first entry, and entries for each unit of the scalar, in units of clim.
    """
    knots = np.concatenate([transfer.opacity_values, transfer.colour_values])
    scalars = np.linspace(knots.min(), knots.max(), BINS)
    extinction = transfer.extinction(scalars)[:, None] * transfer.unit_distance
    rows = np.concatenate([extinction * transfer.colour(scalars), extinction], axis=1)
    sums = np.concatenate([np.zeros((1, 4)), np.cumsum((rows[1:] + rows[:-1]) / 2, axis=0)])
    low, high = in_units_of_clim(scalars[[0, -1]], *transfer.domain).tolist()
    return np.stack([sums, rows]).astype(np.float32), low, (BINS - 1) / (high - low)
