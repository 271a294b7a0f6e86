"""Sizes and numbers that shaders on CPUs read from a block, so that one program serves them all.

On GPUs they are constants (`variant.py`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.blend_mode import BlendMode
from clusterviz.plan.plan import Plan
from clusterviz.plan.segments import Segments
from clusterviz.render.frame_block import voxels_a_slab
from clusterviz.render.storage import Slot

SIZES_BINDING = 9
OCCLUSION_ROWS = 4
"""Rows of ambient occlusion, without those of clipping planes."""
SIZES = np.dtype(
    [
        ("cells", "i4", 4),  # of a stored brick, x, y, z; the brick's side
        ("groups", "i4", 4),  # of cells in a brick, x, y, z; words of a brick's groups
        ("words", "i4", 4),  # in a row, in a slice; of the visibility of a brick's groups
        ("counts", "i4", 4),  # lights, planes that cut what is lit, clipping planes, surfaces
        ("transfer", "i4", 4),  # further starts of segments, pieces of gradient opacity, planes that cut occlusion
        ("first", "i4", 4),  # word of a brick's first cell, samples before it along every axis
    ]
)
PACKETS = {16: (4, 4), 8: (4, 2), 4: (2, 2), 1: (1, 1)}
"""Lanes of a vector: the pixels of a packet across and down."""
COUNTS = {
    "LIGHTS": "counts.x",
    "CAPS": "counts.y",
    "SURFACES": "counts.w",
    "FURTHER_STARTS": "transfer.x",
    "FADING_PIECES": "transfer.y",
    "OCCLUSION_PLANES": "transfer.z",
}
"""Numbers of a volume by their names in shaders."""
CACHED, NEAR = 1 << 22, 0.8  # bytes of bricks and voxels of a slab, above which voxels are fetched ahead


def is_far_apart(plan: Plan, voxel_bytes: int) -> bool:
    """Return whether samples are so far apart, and bricks so large, that caches hold few of the voxels.

    Parameters
    ----------
    voxel_bytes : of the bricks that are drawn
    """
    return voxel_bytes > CACHED and voxels_a_slab(plan) > NEAR


def sizes_block(plan: Plan, slot: Slot) -> NDArray[np.void]:
    """Return the block of a draw, `SIZES` (1 + volumes,): the first record is that of the domain, or of one volume."""
    layers = plan.content.volume_layers if plan.content else ()
    block, unit = np.zeros(1 + len(layers), SIZES), slot.unit
    _tell_volume(block[:1], unit, plan.segments, plan.blend_mode)
    block["cells"][0, 3], block["groups"][0] = plan.layout.brick, (*unit.groups_zyx[::-1], slot.unit.group_words)
    block["words"][0, 2], block["counts"][0, 2] = unit.visibility_words, len(plan.clip)
    for number, (layer, part) in enumerate(zip(layers, slot.parts, strict=True), 1):
        _tell_volume(block[number : number + 1], part, layer.segments, layer.blend_mode)
    return block


def _tell_volume(record: NDArray[np.void], slot: Slot, segments: Segments, blend_mode: BlendMode) -> None:
    shading, grading = blend_mode.shading, blend_mode.grading
    record["cells"][0, :3], (_, y, x) = slot.cells_zyx[::-1], slot.samples_zyx
    record["words"][0, :2] = x, x * y
    record["first"][0, :2] = slot.margin * (1 + x + x * y), slot.margin
    lights, caps = (len(shading.lights), len(shading.caps)) if shading else (0, 0)
    record["counts"][0] = lights, caps, 0, len(blend_mode.surfaces)
    planes = max(0, len(shading.occlusion) - OCCLUSION_ROWS) if shading else 0
    record["transfer"][0, :3] = segments.further_starts, grading.fading if grading else 0, planes
