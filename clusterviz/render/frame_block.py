"""Constants of one draw: a NumPy record with the layout of the shader's block `frame`.

Both ray casters cut rays into batches, slabs whose positions and sum are computed together, so that empty-space
skipping changes no bit of a picture (docs/concepts/accuracy.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.layout import glsl_block
from clusterviz.gl.reals import Reals
from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.content import VolumeLayer
from clusterviz.plan.domain import Cut
from clusterviz.plan.plan import Plan
from clusterviz.plan.segments import BUCKETS
from clusterviz.render.storage import Slot

FRAME = np.dtype(
    [
        ("eye", "f8", 4),  # position in index space
        ("right", "f8", 4),  # slices: length of a slab along the view direction over the longest one
        ("up", "f8", 4),
        ("forward", "f8", 4),  # slices: view depth of the first plane, in distances of planes
        ("lens", "f8", 4),  # pixel distance, column and row of the line of sight, 1 for parallel projection
        ("extent", "f8", 4),  # the volume's last sample in x, y, z; the length of a slab in world units
        ("cells", "i4", 4),  # the volume's cells in x, y, z; slabs of a batch
        ("box_begin", "i4", 4),  # the cells that this draw owns
        ("box_end", "i4", 4),
        ("bricks_begin", "i4", 4),  # the bricks of the box
        ("bricks_count", "i4", 4),
        ("rect", "i4", 4),  # footprint: first pixel in x, y; width, height
        ("scalar", "f4", 4),  # scale and bias from a stored voxel to units of clim
        ("buckets", "f4", 4),  # low, buckets per unit, last bucket; the scalar below which nothing is visible
        # A slab in opacity unit distances; residual that ends a ray or −1; threshold of a run; a dispatch's iterations.
        ("optics", "f4", 4),
        ("last_segment", "i4"),
        ("base", "i4"),  # integer subtracted from 16-bit voxels
        ("first_box", "i4"),  # 1: pixels are empty; 2: pixels are empty, and no other box follows
        ("first_dispatch", "i4"),  # 1: no ray has begun in this box
        # Words of `progress`: set if a ray has to go on in this box; the same of the box before it; the first of the
        # bricks' words, set where a ray has come to a brick. -1: none.
        ("notes", "i4", 4),
    ]
)
ONLY = 2
LONGEST_BATCH = 64  # slabs
WHOLE_RAY = 1 << 20  # slabs of a batch without voxels
WIDEST_BATCH = 128.0
"""Most voxels of a batch, as positions in it are float32."""
BEHIND_OPAQUE = 2.0**-23
"""Transparency that rounding may leave of an opaque surface."""
FRAME_BLOCK = glsl_block("frame", 0, FRAME)
FRAME_BLOCKS: dict[Reals, str] = {"double": FRAME_BLOCK, "integer": FRAME_BLOCK.replace("dvec4", "Column")}
"""By the form of its columns of float64; `Column` is that of reals_integer.glsl."""


def frame_block(plan: Plan, box: BrickBox, rect: Rect, slot: Slot) -> NDArray[np.void]:
    """Return the record for drawing one box of bricks into one rectangle of pixels; `FRAME` (1,).

    The caller sets the fields that change between dispatches.
    """
    record = np.zeros(1, FRAME)
    view, layout = plan.view, plan.layout
    for member in ("eye", "right", "up", "forward"):
        record[member][0, :3] = getattr(view, member)
    if plan.march.lattice == "slices":
        planes = plan.slice_planes
        record["right"][0, 3], record["forward"][0, 3] = planes.distance / plan.march.step_world, planes.first
    record["lens"] = view.pixel, *view.centre, float(view.parallel)
    record["extent"] = *plan.extent, plan.march.step_world
    record["cells"] = *layout.cells_zyx[::-1], _batch(plan)
    begin, end = layout.cells_of(box.begin_zyx, box.end_zyx)
    record["box_begin"][0, :3], record["box_end"][0, :3] = begin[::-1], end[::-1]
    begin, end = layout.unit_box(box.begin_zyx, box.end_zyx)
    record["bricks_begin"][0, :3], record["bricks_count"][0, :3] = begin[::-1], np.subtract(end, begin)[::-1]
    record["rect"] = rect.x_begin, rect.y_begin, rect.width, rect.height
    # Without a residual no ray ends early, so that ranks count the same samples whatever lies in front of them.
    residual = plan.march.residual or -1.0
    if any(layer.opaque for layer in plan.content.geometry):
        residual = max(residual, BEHIND_OPAQUE)
    record["notes"] = -1
    record["optics"][0, 1:3] = residual, plan.blend_mode.threshold
    if not plan.content.mixed:
        _tell_volume(record, plan.volume, slot)
    return record


def _tell_volume(record: NDArray[np.void], volume: VolumeLayer, slot: Slot) -> None:
    """Write what is known of a volume alone; mixed ones have blocks of their own."""
    encoding, segments = volume.encoding, volume.segments
    # The texture unit cannot subtract the base before it interpolates.
    bias = encoding.bias - encoding.scale * encoding.base if slot.textured else encoding.bias
    record["scalar"][0, :2] = slot.texel_scale * encoding.scale, bias
    record["buckets"] = segments.low, segments.per_unit, BUCKETS - 1, segments.transparent_below
    record["optics"][0, 0] = volume.slab_units
    record["last_segment"], record["base"] = len(segments.records) - 1, encoding.base


def _batch(plan: Plan) -> int:
    """Return the slabs of a batch; positions are counted from its middle, which should lie in its brick."""
    if not plan.content.volume_layers:
        return WHOLE_RAY
    widest = min(2.0 * plan.layout.brick, WIDEST_BATCH)
    return slabs_in_batch(widest / voxels_a_slab(plan), LONGEST_BATCH)


def slabs_in_batch(most: float, longest: int) -> int:
    """Return the slabs of a batch: the largest power of two up to `most` and `longest`, and at least 1."""
    return 1 << int(np.log2(np.clip(most, 1, longest)))


def voxels_a_slab(plan: Plan, cut: Cut | None = None) -> float:
    """Return an upper bound on the voxels of a slab in any direction; with a cut, voxels of its volume."""
    axes = np.array([plan.view.right, plan.view.up, plan.view.forward])
    voxels = plan.march.step_world * float(np.sqrt((axes**2).sum()))
    return voxels if cut is None else voxels * float(np.linalg.norm(cut.index_from_domain[:, :3]))
