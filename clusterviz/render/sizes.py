"""Sizes and numbers that shaders on CPUs read from a block, so that one program serves them all.

On GPUs they are constants (`variant.py`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.plan import Plan
from clusterviz.render.frame_block import voxels_a_slab
from clusterviz.render.storage import Slot

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
    unit = slot.unit
    block = np.zeros(1 + len(slot.parts), SIZES)
    for record, part in zip(block, (unit, *slot.parts), strict=True):
        _, y, x = part.samples_zyx
        record["cells"][:3], record["words"][:2] = part.cells_zyx[::-1], (x, x * y)
        record["first"][:2] = part.margin * (1 + x + x * y), part.margin
    for record, layer in zip(block[slot.mixed :], plan.content.volume_layers, strict=True):
        mode, shading, grading = layer.blend_mode, layer.blend_mode.shading, layer.blend_mode.grading
        lights, caps = (len(shading.lights), len(shading.caps)) if shading else (0, 0)
        record["counts"] = lights, caps, 0, len(mode.surfaces)
        planes = max(0, len(shading.occlusion) - OCCLUSION_ROWS) if shading else 0
        record["transfer"][:3] = layer.segments.further_starts, grading.fading if grading else 0, planes
    block["cells"][0, 3], block["groups"][0] = plan.layout.brick, (*unit.groups_zyx[::-1], unit.group_words)
    block["words"][0, 2], block["counts"][0, 2] = unit.visibility_words, len(plan.clip)
    return block
