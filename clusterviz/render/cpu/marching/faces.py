"""Where rays meet the faces of bricks: the twin of met, brick_along and in_box in split.glsl, in double precision.

Along a ray, slabs are counted from where its lattice begins: slab k goes from k to k + 1. Where it meets faces is found
by one expression, which never falls from one face to the next: in every box the same places.
"""

from __future__ import annotations

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import F64, I32, Value, Vector
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.rays import FAR, Rays


class Faces:
    """The bricks of a draw's volume.

    Attributes
    ----------
    brick : cells along its side
    last : the number of the last brick along x, y, z
    """

    def __init__(self, code: Code, job: Job) -> None:
        self._code, self._job, self.brick, self._per_brick = code, job, job["brick"], job["per_brick"]
        self.last = [((job.part("cells", k).to(F64) - 0.5) * self._per_brick).to(I32) for k in range(3)]

    def met(self, rays: Rays, axis: int, cell: Value) -> Value:
        """Where rays meet the face in front of a cell; anything for those that run along it."""
        by = rays.slab[axis]
        safe = self._code.select(by.equals(0.0), 1.0, by)
        return (cell.to(F64) - rays.first[axis]) / safe + 0.5

    def position(self, rays: Rays, along: Value) -> Vector:
        """The places that lie so many slabs along."""
        x, y, z = (self._code.fma(along - 0.5, by, at) for by, at in zip(rays.slab, rays.first, strict=True))
        return x, y, z

    def bricks_at(self, rays: Rays, along: Value) -> tuple[Vector, Value]:
        """The numbers of the bricks there, along x, y, z, and where rays leave them for others."""
        found, leave = [], self._code.same(F64, FAR)
        for axis, at in enumerate(self.position(rays, along)):
            number, end = self._brick_along(rays, axis, at, along)
            found.append(number)
            leave = self._code.least(end, leave)
        return (found[0], found[1], found[2]), leave

    def in_box(self, rays: Rays) -> tuple[Value, Value]:
        """Which part of rays is in the draw's box of bricks."""
        code, job = self._code, self._job
        enter, leave = code.same(F64, -FAR), code.same(F64, FAR)
        for axis, at in enumerate(rays.first):
            begin = job.part("bricks_begin", axis)
            end = begin + job.part("bricks_count", axis)
            low, high = (self.met(rays, axis, code.splat(number * self.brick)) for number in (begin, end))
            by = rays.slab[axis]
            rises, falls = by > 0.0, by < 0.0
            # The volume's own faces cut nothing.
            first, past = begin > 0, end <= self.last[axis]
            low_cuts, high_cuts = ((code.splat(one.to(I32)) > 0) for one in (first, past))
            enter = code.select(rises & low_cuts, code.most(enter, low), enter)
            enter = code.select(falls & high_cuts, code.most(enter, high), enter)
            leave = code.select(rises & high_cuts, code.least(leave, high), leave)
            leave = code.select(falls & low_cuts, code.least(leave, low), leave)
            still = self._guess(axis, at)
            outside = ~(rises | falls) & ((still < begin) | (still >= end))
            leave = code.select(outside, -FAR, leave)
        return enter, leave

    def _guess(self, axis: int, position: Value) -> Value:
        number = self._code.call("floor", position * self._per_brick)
        return self._code.within(number, 0.0, self.last[axis].to(F64)).to(I32)

    def _brick_along(self, rays: Rays, axis: int, position: Value, along: Value) -> tuple[Value, Value]:
        """The guess is within one of the truth."""
        code, last, by = self._code, self.last[axis], rays.slab[axis]
        guess, rises, runs = self._guess(axis, position), by > 0.0, ~by.equals(0.0)
        ahead, back = code.select(rises, code.same(I32, 1), -1), code.select(rises, code.same(I32, 0), 1)
        begins_inside = code.select(rises, guess, last - guess) > 0
        begin = self.met(rays, axis, (guess + back) * self.brick)
        end = self.met(rays, axis, (guess + (1 - back)) * self.brick)
        early = runs & begins_inside & (begin > along)
        late = runs & ~early & (code.select(rises, last - guess, guess) > 0) & (end <= along)
        number = code.select(early, guess - ahead, code.select(late, guess + ahead, guess))
        ends_inside = runs & (code.select(rises, last - number, number) > 0)
        end = self.met(rays, axis, (number + (1 - back)) * self.brick)
        return number, code.select(ends_inside, end, FAR)
