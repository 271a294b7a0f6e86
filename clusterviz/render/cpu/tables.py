"""Uniform blocks and storage buffers of a draw on a CPU, by their bindings in the shaders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.plan import Plan
from clusterviz.render.cpu.memory import BrickTable
from clusterviz.render.cpu.pieces import MOST, ROWS, Pieces
from clusterviz.render.frame_block import ONLY, WIDEST_BATCH, frame_block, slabs_in_batch, voxels_a_slab
from clusterviz.render.sizes import SIZES_BINDING, sizes_block
from clusterviz.render.storage import Slot
from clusterviz.render.volume_layers import all_segments, content_tables, volume_blocks
from clusterviz.spmd.machine_code import texture_block

LONGEST_BATCH = 32  # slabs
EXACT = 1 << 23  # whole numbers up to here, and sums of two, are float32
Blocks = dict[int, NDArray[Any]]


def uniform_blocks(plan: Plan, slot: Slot) -> Blocks:
    """Return the uniform blocks that all frames of the same bricks share."""
    found: Blocks = {SIZES_BINDING: sizes_block(plan, slot)}
    if len(plan.clip):
        found[3] = np.ascontiguousarray(plan.clip)
    return found | dict(volume_blocks(plan.content, on_cpu=True))


def brick_buffers(plan: Plan, table: BrickTable, groups: NDArray[Any], pieces: Sequence[Pieces | None]) -> Blocks:
    """Return the storage buffers that all windows of the same bricks share.

    Parameters
    ----------
    groups : how far rays may skip, or the bits of groups of cells, as the shader reads them
    pieces : of each volume's transfer function, if registers hold it
    """
    buckets, records, sums = all_segments(plan)
    found = {3: table.offsets, 4: buckets, 5: records, 6: groups, 7: table.voxels}
    found |= {} if sums is None else {0: sums}
    found |= {} if table.pitches is None else {8: table.pitches}
    if any(pieces):
        found[9] = np.concatenate([one.table if one else np.zeros((ROWS, MOST), np.float32) for one in pieces])
    found |= {} if table.bases is None else {10: table.bases}
    return {binding: np.ascontiguousarray(buffer) for binding, buffer in found.items()}


def textures(plan: Plan) -> Blocks:
    """Return the 2-D transfer functions."""
    return {binding: texture_block(table.astype(np.float32)) for binding, table in content_tables(plan.content)}


def frame_of(plan: Plan, box: BrickBox, rect: Rect, slot: Slot) -> NDArray[np.void]:
    """Return the record of the block `frame`; batches of voxels suit the whole numbers of float32."""
    frame = frame_block(plan, box, rect, slot)
    frame["first_box"], frame["first_dispatch"] = ONLY, 1
    voxels = [(slot, voxels_a_slab(plan))]
    if slot.mixed:
        layers = zip(slot.parts, plan.content.volume_layers, strict=True)
        voxels = [(part, voxels_a_slab(plan, layer.cut)) for part, layer in layers]
    if not voxels:
        return frame
    most = slabs_in_batch(min(_widest_batch(part) / a_slab for part, a_slab in voxels), LONGEST_BATCH)
    frame["cells"][0, 3] = min(most, int(frame["cells"][0, 3]))
    return frame


def _widest_batch(slot: Slot) -> float:
    """Return the voxels of a batch, at most, so that the number of a word is exact in float32."""
    _, y, x = slot.samples_zyx
    return float(min(EXACT / (x * y + x + 1) - 2, WIDEST_BATCH))
