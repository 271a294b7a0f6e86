"""Where the slabs of rays are, and how far their rays may go there: the twin of place_of in march.glsl."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import BYTES, F32, F64, I32, Value, Vector
from clusterviz.render.vectors.fields.field import Spot
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.marching.rays import cell_of
from clusterviz.render.vectors.marching.stretch import Stretch

GROUP_SHIFT = 3  # groups of 8 cells a side, as in storage.py
WHOLE_BRICK = -1  # a leap over what is left of the brick
LONGEST_LEAP = 1 << 20  # slabs
FARTHEST = 1 << 30


@dataclass(frozen=True)
class Place:
    """Where slabs are.

    Attributes
    ----------
    visible : something may be visible there
    slabs : how many from here on share this answer
    brick : the number of its first cell in the volume along x, y, z, int32
    voxels : the number of its first voxel, of the job's `word`
    cell : of the midpoint, in the volume, int32
    doublings : how often slabs may be doubled; None where they are never
    """

    visible: Value
    slabs: Value
    brick: Vector
    voxels: Value
    cell: Vector
    doublings: Value | None = None


class Places:
    """The bricks and groups of cells of a draw as its kernel reads them.

    Parameters
    ----------
    nearest : voxels are looked up, not cells
    stretch : where slabs may be longer; None: nowhere
    """

    def __init__(self, code: Code, job: Job, nearest: bool, stretch: Stretch | None = None) -> None:
        self._code, self._job, self._brick, self._stretch = code, job, job["brick"], stretch
        self._begin, self._count = ([job.part(name, k) for k in range(3)] for name in ("bricks_begin", "bricks_count"))
        self._sides = [job.part("group_sides", k) for k in range(4)]
        self._first = job["first_cell"]
        self._last = [job.part("last_cell", axis) + int(nearest) for axis in range(3)]
        # Where groups are of one size, leaps go on into other bricks.
        self._farthest = code.select((self._brick & ((1 << GROUP_SHIFT) - 1)).equals(0), FARTHEST, self._brick)
        self._slack = code.splat(job["slack"])

    def of(self, position: Vector, slab: Vector, per_slab: Vector) -> Place:
        """The place of a midpoint that the box owns.

        Parameters
        ----------
        slab : float32, from one midpoint to the next
        per_slab : float32, one over its size
        """
        code = self._code
        cell = cell_of(code, self._job, position)
        beyond = _each(lambda at, whole: (at - whole.to(F64)).to(F32), position, cell)
        number = [self._divided(at) for at in cell]
        local = _each(lambda at, whole: at - whole * self._brick, cell, number)
        # Rays that have left the box, or never meet it, are told of some brick of it.
        inside = zip(number, self._begin, self._count, strict=True)
        x, y, z = (code.within(at - begin, 0, count - 1) for at, begin, count in inside)
        brick = (z * self._count[1] + y) * self._count[0] + x
        group = _each(lambda at, _: at >> GROUP_SHIFT, local, local)
        within = (group[2] * self._sides[1] + group[1]) * self._sides[0] + group[0]
        leap = code.gather(I32, self._job["leaps"], brick * self._sides[3] + within, 4)
        voxels = self._voxels_of(brick)
        visible, doublings = leap.equals(0), None
        if self._stretch:
            doublings = self._stretch.allowed(leap)
            # Longer slabs end with their group.
            visible, leap = visible | (doublings > 0), code.select(doublings > 0, 1, leap)
        here = _each(lambda at, by: at.to(F32) + by, local, beyond)
        slabs = self._slabs(here, group, leap, (slab, per_slab))
        first = _each(lambda at, _: at * self._brick, number, number)
        return Place(visible, slabs, first, voxels, cell, doublings)

    def spot(self, place: Place, position: Vector) -> Spot:
        """Where a midpoint is, as seen from the first corner of its cell."""
        return self._seen_from(place, position, place.cell)

    def window(self, place: Place, position: Vector, begin: Value, here: Value) -> Spot:
        """Where runs are, as seen from the midpoint with which their window begins; anywhere for those not here.

        So what a slab's place is in float32 depends on the ray alone, not on where its run begins.

        Parameters
        ----------
        position : of that midpoint; it may lie in another brick
        begin : how many slabs behind it the runs begin, int32
        """
        code = self._code
        cell = _each(lambda at, near: code.select(here, code.call("floor", at).to(I32), near), position, place.cell)
        return replace(self._seen_from(place, position, cell), begin=begin.to(F32))

    def _seen_from(self, place: Place, position: Vector, cell: Vector) -> Spot:
        local = _each(lambda at, first: at - first, cell, place.brick)
        voxel = place.voxels + self._voxel(local)
        low = _each(lambda at, _: (self._first - at).to(F32), local, local)
        high = _each(lambda last, at: (last - at).to(F32), self._last, local)
        beyond = _each(lambda at, whole: (at - whole.to(F64)).to(F32), position, cell)
        return Spot(voxel, low, high, beyond, cell)

    def _slabs(self, at: Vector, group: Vector, leap: Value, slab: tuple[Vector, Vector]) -> Value:
        """How many midpoints from here on lie in the box that shares the answer, for certain: at least one.

        That box is the brick, or the groups that a leap crosses. It is taken to be smaller by more than float32 has
        rounded away, so that no slab is taken that a neighbour, who decides exactly, takes too.
        """
        code, whole, least = self._code, leap <= 0, self._code.same(F32, float(LONGEST_LEAP))
        for axis in range(3):
            low = code.select(whole, 0, (group[axis] - (leap - 1)) << GROUP_SHIFT)
            high = code.select(whole, self._brick, self._group_end(group[axis] + leap))
            rises = slab[0][axis] >= 0.0
            ahead = code.select(rises, high.to(F32) - at[axis], at[axis] - low.to(F32)) - self._slack
            least = code.least(ahead * slab[1][axis], least)
        return code.most((least - 1e-3).to(I32) + 1, 1)

    def _voxel(self, local: Vector) -> Value:
        """The number of a cell's first corner in its brick, of the job's `word`."""
        x, y, z = (at - self._job["first_voxel"] for at in local)
        return (z * self._job["layer"] + y * self._job["row"] + x).to(self._job.word)

    def _voxels_of(self, brick: Value) -> Value:
        """The number of the first voxel of a brick of the box; some other's, where it is not here."""
        word = self._job.word
        return self._code.gather(word, self._job["bricks"], brick, BYTES[word])

    def _divided(self, cell: Value) -> Value:
        """The number of the brick that holds a cell; exact, as in march.glsl."""
        return ((cell.to(F64) + 0.5) * self._job["per_brick"]).to(I32)

    def _group_end(self, group: Value) -> Value:
        """Where a group ends; the last one of a brick may be cut."""
        return self._code.least(group << GROUP_SHIFT, self._farthest)


def _each(function: Callable[[Value, Value], Value], a: Sequence[Value], b: Sequence[Value]) -> Vector:
    """A function of two vectors' components, one by one."""
    x, y, z = (function(first, second) for first, second in zip(a, b, strict=True))
    return x, y, z
