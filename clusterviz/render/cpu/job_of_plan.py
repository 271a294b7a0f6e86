"""A draw as a job for the kernel: from a plan and the bricks in memory to numbers and addresses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.blend_mode import BlendMode
from clusterviz.plan.multi_volume import VolumeLayer
from clusterviz.plan.plan import Plan
from clusterviz.plan.segments import BUCKETS, Segments
from clusterviz.render.cpu.job import JOB
from clusterviz.render.cpu.marching.empty_space import FARTHEST
from clusterviz.render.cpu.marching.tile import TILE
from clusterviz.render.cpu.memory import Numbers
from clusterviz.render.cpu.multi_volume_memory import Numbered
from clusterviz.render.cpu.transfer.classify import bucket_rows, colour_rows
from clusterviz.render.cpu.transfer.pieces import Pieces
from clusterviz.render.frame_block import WIDEST_BATCH, frame_block, slabs_in_batch, voxels_a_slab
from clusterviz.render.storage import GROUP, Slot

LONGEST_BATCH = 32  # slabs
EXACT = 1 << 23  # whole numbers up to here, and sums of two, are float32
CACHED, NEAR = 1 << 22, 0.8  # bytes of bricks and voxels of a slab, from which voxels are asked for ahead
ROUNDED = 5e-7  # share of a length that a few operations of float32 may lose
Tables = dict[str, NDArray[Any]]


def tables_of(
    plan: Plan, numbered: tuple[NDArray[np.uint32], Numbers], skips: NDArray[np.int32], pieces: Pieces | None
) -> Tables:
    """The arrays that a kernel reads, by the names of the job's addresses; they must outlive the draw.

    Parameters
    ----------
    numbered : as of `Memory.numbered`
    skips : as of `skips_of`
    pieces : of the transfer function, where they are few
    """
    voxels = {"voxels": numbered[0], "bricks": numbered[1]}
    return domain_tables(plan, skips) | voxels | segment_tables(plan.segments, pieces) | look_tables(plan.blend_mode)


def domain_tables(plan: Plan, skips: NDArray[np.int32]) -> Tables:
    """Those that do not belong to one of several volumes."""
    return {"skips": skips, "clip": np.ascontiguousarray(plan.clip)}


def segment_tables(segments: Segments, pieces: Pieces | None) -> Tables:
    """Those of a transfer function."""
    tables: Tables = {"bucket_rows": bucket_rows(segments), "record_rows": segments.records}
    classes = {"colour_rows": colour_rows(segments)} if segments.sums is None else {"sums": segments.sums}
    return tables | classes | ({} if pieces is None else {"pieces": pieces.table})


def look_tables(blend_mode: BlendMode) -> Tables:
    """Those that only some looks have."""
    shading, grading = blend_mode.shading, blend_mode.grading
    tables: Tables = {"lighting": shading.block()} if shading else {}
    if blend_mode.surfaces:
        tables["surface"] = blend_mode.surface_block()
    if grading:
        tables["grading"] = grading.block()
        if grading.table is not None:
            tables["table"] = np.ascontiguousarray(grading.table)
    return tables


def job_of(plan: Plan, shown: tuple[BrickBox, int], rect: Rect, slot: Slot, tables: Tables) -> NDArray[np.void]:
    """The job, `JOB` (1,).

    Parameters
    ----------
    shown : a box, and how many bricks of it are drawn
    tables : those of `tables_of`; `pixels`, float32 (rows, columns, 4), and `work` as in `RenderResult`, which it
    writes
    """
    (box, bricks), job = shown, np.zeros(1, JOB)
    job["frame"] = frame_block(plan, box, rect, slot)
    job["whole"] = box.shape_zyx == plan.layout.counts_zyx
    job["brick"], job["per_brick"] = plan.layout.brick, 1 / plan.layout.brick
    job["planes"], job["window"] = len(plan.clip), _window(plan, slot)
    tell_volume(job, slot, plan.segments, plan.blend_mode, slot.reach)
    units = int(np.count_nonzero(tables["pitches"][..., 0])) if "pitches" in tables else bricks
    job["far"] = "voxels" in tables and is_far(4 * units * int(np.prod(slot.unit.samples_zyx)), voxels_a_slab(plan))
    job["slack"] = ROUNDED * (plan.layout.brick + 2 * GROUP * FARTHEST)
    across, down = -(-rect.width // TILE), -(-rect.height // TILE)
    job["tiles_across"], job["tiles"], job["stride"] = across, across * down, tables["pixels"].shape[1]
    job["squares_across"] = tables["work"].shape[1]
    sides = slot.unit.groups_zyx[::-1]
    job["group_sides"] = *sides, np.prod(sides)
    tell_tables(job, tables)
    return job


def tell_volume(job: NDArray[np.void], slot: Slot, segments: Segments, blend_mode: BlendMode, reach: int) -> None:
    """Tell a job (1,) how the voxels of a slot lie, and what is made of them.

    Parameters
    ----------
    reach : cells beyond the slot's own that may be sampled
    """
    _, y, x = slot.samples_zyx
    job["row"], job["layer"] = x, x * y
    job["first_cell"], job["first_voxel"] = -reach, -slot.margin
    job["last_cell"][0, :3] = np.array(slot.unit.cells_zyx[::-1]) - 1 + reach
    job["further_starts"], job["record_floats"] = segments.further_starts, segments.records.itemsize // 4
    shading, grading = blend_mode.shading, blend_mode.grading
    job["lights"], job["surfaces"] = len(shading.lights) if shading else 0, len(blend_mode.surfaces)
    job["caps"] = len(shading.caps) if shading else 0
    if grading:
        job["fading"] = grading.fading
        if grading.table is not None:
            job["table_sides"] = grading.table.shape[1::-1]


def is_far(memory: int, voxels: float) -> bool:
    """Whether samples are so many voxels apart, and bricks so many bytes, that caches hold few of them."""
    return memory > CACHED and voxels > NEAR


def tell_tables(job: NDArray[np.void], tables: Tables) -> None:
    """Tell a job where its tables are."""
    for name, table in tables.items():
        job[name] = table.__array_interface__["data"][0]


def hand_over(job: NDArray[np.void], memory: Tables, depth: NDArray[np.float64], offset: int) -> None:
    """Tell a job where its rays start and where to write what they hit: `LastFrame.arrays`, `depth_of`."""
    tell_tables(job, memory)
    job["plane"], job["depth"], job["offset"] = memory["starts"].nbytes, depth, offset


def _window(plan: Plan, slot: Slot) -> int:
    """Slabs of a window: their cells can be told from the first one's by a whole number in float32."""
    voxels = [(slot, voxels_a_slab(plan))]
    if plan.multi_volume is not None:
        parts = zip(slot.parts, plan.multi_volume.volume_layers, strict=True)
        voxels = [(room, voxels_a_slab(plan, part.cut)) for room, part in parts]
    return slabs_in_batch(min(farthest(room) / a_slab for room, a_slab in voxels), LONGEST_BATCH)


def farthest(slot: Slot) -> float:
    """Voxels of a window, at most."""
    _, y, x = slot.samples_zyx
    return float(min(EXACT / (x * y + x + 1) - 2, WIDEST_BATCH))


@dataclass(frozen=True, eq=False)
class VolumeJobs:
    """The volumes of a draw.

    Attributes
    ----------
    records : JOB (n,), one a volume
    tables : what these point to
    """

    records: NDArray[np.void]
    tables: tuple[Tables, ...]

    @property
    def wide(self) -> bool:
        """Whether the numbers of voxels take 64 bits."""
        return self.tables[0]["bricks"].itemsize == 8


def volume_jobs(plan: Plan, slot: Slot, bricks: Sequence[Numbered], pieces: Sequence[Pieces | None]) -> VolumeJobs:
    """The volumes of a plan that has several.

    Parameters
    ----------
    bricks : where they begin in each volume
    pieces : of the transfer function of each, where they are few
    """
    assert plan.multi_volume is not None, "the plan is one of several volumes"
    records, tables = np.zeros(len(slot.parts), JOB), []
    for number, part in enumerate(plan.multi_volume.volume_layers):
        job, room = records[number : number + 1], slot.parts[number]
        _tell_frame(job, part)
        # What parts reach beyond a brick of the domain lies in their cells.
        tell_volume(job, room, part.segments, part.blend_mode, reach=0)
        own = bricks[number]
        job["far"] = is_far(own.bricks * own.voxels.nbytes, voxels_a_slab(plan, part.cut))
        job["farthest"] = max(2, farthest(room) + 2)
        voxels: Tables = {"voxels": own.voxels, "bricks": own.numbers, "firsts": own.firsts}
        tables.append(voxels | segment_tables(part.segments, pieces[number]) | look_tables(part.blend_mode))
        tell_tables(job, tables[-1])
    return VolumeJobs(records, tuple(tables))


def _tell_frame(job: NDArray[np.void], part: VolumeLayer) -> None:
    """What the frame's block says of one volume alone."""
    frame, segments, encoding, last = job["frame"], part.segments, part.encoding, np.array(part.cut.shape_zyx[::-1]) - 1
    frame["extent"][0, :3], frame["cells"][0, :3] = last, np.maximum(last, 1)
    frame["scalar"][0, :2], frame["base"] = (encoding.scale, encoding.bias), encoding.base
    frame["buckets"] = segments.low, segments.per_unit, BUCKETS - 1, segments.transparent_below
    frame["optics"][0, 0], frame["last_segment"] = part.slab_units, len(segments.records) - 1
    job["index_from_domain"] = part.cut.index_from_domain.reshape(-1)
