"""Where the slabs of rays are, and how far their rays may go there: the twin of place_of in march.glsl."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import BYTES, F32, F64, I32, Value, Vector, vector_of
from clusterviz.render.cpu.fields.field import Pitch, Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.adaptive_step import Stretch
from clusterviz.render.cpu.marching.rays import cell_of

GROUP_SHIFT = 3  # groups of 8 cells a side, as in storage.py
WHOLE_BRICK = -1  # a skip over what is left of the brick
LONGEST_SKIP = 1 << 20  # slabs
FARTHEST = 1 << 30


@dataclass(frozen=True)
class Window:
    """Where the windows of rays begin; what lies in them is counted from there in float32.

    Attributes
    ----------
    cell : that holds the midpoint, in the volume, int32
    beyond : float32, from that cell's corner to the midpoint
    brick : the number of the cell's brick along x, y, z, int32
    local : of the cell in that brick; whole numbers as float32, as all that follow
    """

    cell: Vector
    beyond: Vector
    brick: Vector
    local: Vector


@dataclass(frozen=True)
class Place:
    """Where slabs are.

    Attributes
    ----------
    visible : something may be visible there
    slabs : how many from here on share this answer
    voxels : the number of its brick's first voxel, of the job's `word`
    begin : the cell with which the window begins, as seen from the brick's first one; whole numbers as float32
    doublings : how often slabs may be doubled; None where they are never
    """

    visible: Value
    slabs: Value
    voxels: Value
    begin: Vector
    doublings: Value | None = None


class Places:
    """The bricks and groups of cells of a draw as its kernel reads them.

    Parameters
    ----------
    nearest : voxels are looked up, not cells
    stretch : where slabs may be longer; None: nowhere
    pitch : of the bricks
    """

    def __init__(self, code: Code, job: Job, nearest: bool, pitch: Pitch, stretch: Stretch | None = None) -> None:
        self._code, self._job, self._brick, self._stretch, self._pitch = code, job, job["brick"], stretch, pitch
        self._begin, self._count = ([job.part(name, k) for k in range(3)] for name in ("bricks_begin", "bricks_count"))
        self._sides = [job.part("group_sides", k) for k in range(4)]
        self._first = job["first_cell"]
        self._last = [job.part("last_cell", axis) + int(nearest) for axis in range(3)]
        self._side, self._per_brick = code.splat(self._brick.to(F32)), code.splat(job["per_brick"].to(F32))
        # Where groups are of one size, skips go on into other bricks.
        self._farthest = code.select((self._brick & ((1 << GROUP_SHIFT) - 1)).equals(0), FARTHEST, self._brick)
        self._slack = code.splat(job["slack"])
        self._ends = [(job.part("box_begin", k).to(F64), (job.part("box_end", k) - 1).to(F64)) for k in range(3)]

    def window(self, position: Vector, here: Value) -> Window:
        """Of a midpoint; somewhere in the box for rays that are not here, so that what they read is near."""
        code, job = self._code, self._job
        begins = [job.part("box_begin", axis) for axis in range(3)]
        cell = _each(lambda at, begin: code.select(here, at, begin), cell_of(code, job, position), begins)
        beyond = _each(lambda at, whole: code.select(here, (at - whole.to(F64)).to(F32), 0.0), position, cell)
        # Integer division is slow where there is no hardware for it; this is exact, as in march.glsl.
        brick = _each(lambda at, _: ((at.to(F64) + 0.5) * job["per_brick"]).to(I32), cell, cell)
        local = _each(lambda at, number: (at - number * self._brick).to(F32), cell, brick)
        return Window(cell, beyond, brick, local)

    def of(self, window: Window, midpoint: Vector, along: Value, slab: Vector, per_slab: Vector) -> Place:
        """The place of a slab that the box owns.

        Parameters
        ----------
        midpoint : of the slab, float64
        along : how many slabs behind the window's begin, float32
        slab : float32, from one midpoint to the next
        per_slab : float32, one over its size
        """
        code = self._code
        # Rays that have left the box are told of some cell of it.
        inside = vector_of([code.within(at, *ends) for at, ends in zip(midpoint, self._ends, strict=True)])
        cell = _each(lambda at, by: (at.to(I32) - by).to(F32), inside, window.cell)
        position = _each(lambda at, by: code.fma(along, by, at), window.beyond, slab)
        beyond = _each(lambda at, by: at - by, position, cell)
        from_brick = _each(lambda at, by: at + by, window.local, cell)
        number = _each(lambda at, _: code.call("floor", (at + 0.5) * self._per_brick), from_brick, cell)
        local = _each(lambda at, by: at - by * self._side, from_brick, number)
        x, y, z = (
            at.to(I32) + brick - begin for at, brick, begin in zip(number, window.brick, self._begin, strict=True)
        )
        brick = (z * self._count[1] + y) * self._count[0] + x
        group = _each(lambda at, _: at.to(I32) >> GROUP_SHIFT, local, local)
        within = (group[2] * self._sides[1] + group[1]) * self._sides[0] + group[0]
        skip = code.gather(I32, self._job["skips"], brick * self._sides[3] + within, 4)
        visible, doublings = skip.equals(0), None
        if self._stretch:
            doublings = self._stretch.allowed(skip)
            # Longer slabs end with their group.
            visible, skip = visible | (doublings > 0), code.select(doublings > 0, 1, skip)
        here = _each(lambda at, by: at + by, local, beyond)
        slabs = self._slabs(here, group, skip, (slab, per_slab))
        begin = _each(lambda at, by: at - by * self._side, window.local, number)
        return Place(visible, slabs, self._voxels_of(brick), begin, doublings)

    def spot(self, place: Place, window: Window, along: Value | None = None) -> Spot:
        """Where slabs are in their brick, as seen from the cell with which their window begins.

        So what a slab's place is in float32 depends on the ray alone, not on where its run begins.

        Parameters
        ----------
        along : how many slabs behind the window's begin, float32; None: there
        """
        low = _each(lambda at, _: self._first.to(F32) - at, place.begin, place.begin)
        high = _each(lambda last, at: last.to(F32) - at, self._last, place.begin)
        voxel = place.voxels + self._voxel(_each(lambda at, _: at.to(I32), place.begin, place.begin))
        return Spot(voxel, low, high, window.beyond, window.cell, along)

    def _slabs(self, at: Vector, group: Vector, skip: Value, slab: tuple[Vector, Vector]) -> Value:
        """How many midpoints from here on lie in the box that shares the answer, for certain: at least one.

        That box is the brick, or the groups that a skip crosses. It is taken to be smaller by more than float32 has
        rounded away, so that no slab is taken that a neighbour, who decides exactly, takes too.
        """
        code, whole, least = self._code, skip <= 0, self._code.same(F32, float(LONGEST_SKIP))
        for axis in range(3):
            low = code.select(whole, 0, (group[axis] - (skip - 1)) << GROUP_SHIFT)
            high = code.select(whole, self._brick, self._group_end(group[axis] + skip))
            rises = slab[0][axis] >= 0.0
            ahead = code.select(rises, high.to(F32) - at[axis], at[axis] - low.to(F32)) - self._slack
            least = code.least(ahead * slab[1][axis], least)
        return code.most((least - 1e-3).to(I32) + 1, 1)

    def _voxel(self, local: Vector) -> Value:
        """The number of a cell's first corner in its brick, of the job's `word`."""
        x, y, z = (at - self._job["first_voxel"] for at in local)
        return self._pitch.voxel((x, y, z))

    def _voxels_of(self, brick: Value) -> Value:
        """The number of the first voxel of a brick of the box; some other's, where it is not here."""
        word = self._job.word
        self._pitch.enter(brick)
        return self._code.gather(word, self._job["bricks"], brick, BYTES[word])

    def _group_end(self, group: Value) -> Value:
        """Where a group ends; the last one of a brick may be cut."""
        return self._code.least(group << GROUP_SHIFT, self._farthest)


def _each(function: Callable[[Any, Any], Value], a: Sequence[Any], b: Sequence[Any]) -> Vector:
    """A function of two vectors' components, one by one."""
    return vector_of([function(first, second) for first, second in zip(a, b, strict=True)])
