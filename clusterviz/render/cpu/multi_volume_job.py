"""Several volumes as jobs: a record for each, and the tables that it points to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.multi_volume import VolumeLayer
from clusterviz.plan.plan import Plan
from clusterviz.plan.segments import BUCKETS
from clusterviz.render.cpu.job import JOB
from clusterviz.render.cpu.job_of_plan import (
    Tables,
    farthest,
    is_far,
    look_tables,
    segment_tables,
    tell_tables,
    tell_volume,
)
from clusterviz.render.cpu.multi_volume_memory import Numbered
from clusterviz.render.cpu.transfer.pieces import Pieces
from clusterviz.render.frame_block import voxels_a_slab
from clusterviz.render.storage import Slot


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
