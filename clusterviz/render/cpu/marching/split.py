"""The march where slabs are cut as they leave a brick, which never samples beyond its own cells: twin of split.glsl.

Along a ray, slabs are counted from where its lattice begins: slab k goes from k to k + 1. Where it meets faces is found
by one expression, which never falls from one face to the next: in every box the same places.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

from typing import Protocol

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, F64, I32, Value, Vector, vector_of
from clusterviz.render.cpu.fields.field import Pitch, Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.clip import keeps, kept_range
from clusterviz.render.cpu.marching.march import AsyncCompositing, Four, Variables
from clusterviz.render.cpu.marching.rays import FAR, Rays, packet_rays
from clusterviz.render.cpu.marching.sample_positions import GROUP_SHIFT, WHOLE_BRICK, Places
from clusterviz.render.cpu.marching.state import NEVER, Layout, Packet


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


JUST_BEHIND = 1e-6  # slabs
SPLIT: Layout = (("along", F64, 1), ("until", F64, 1))
"""How far along rays are, and where they leave the box, the volume, or what planes keep."""


class SplitLook(AsyncCompositing, Protocol):
    """What becomes of parts of slabs."""

    def parts(self, spot: Spot, slab: Vector, first: Value, begin: Value, leave: Value) -> tuple[Four, Value]:
        """What parts of slabs come to between two places, counted from a third, whose spot it is; and how many."""


class SplitMarch:
    """The march of a kernel.

    Parameters
    ----------
    jittered : every pixel has a lattice of slabs of its own
    pitch : of the bricks
    """

    keeps_more = SPLIT

    def __init__(self, code: Code, job: Job, blend_mode: SplitLook, jittered: bool, pitch: Pitch) -> None:
        self._code, self._job, self._blend_mode, self._jittered = code, job, blend_mode, jittered
        self._faces = Faces(code, job)
        self._places = BrickPlaces(code, job, False, pitch)

    def rays_through(self, x: Value, y: Value) -> Rays:
        """The rays through the pixels (x, y) of the picture."""
        return packet_rays(self._code, self._job, x, y, self._jittered)

    def begin(self, packet: Packet, rays: Rays, inside: Value) -> Value:
        """Write a packet's first state; `inside` says which lanes are pixels. Returns whether there is any slab."""
        code = self._code
        kept_from, kept_to = self._kept(rays)
        shift = code.same(F64, 0.0) if rays.first_share is None else 1.0 - rays.first_share.to(F64)
        last = code.select(rays.slabs > 1, (rays.slabs - 1).to(F64), shift) + rays.last_share.to(F64)
        enter, leave = self._faces.in_box(rays)
        along = code.most(code.most(kept_from.to(F64), shift), enter)
        until = code.least(last, code.least(kept_to.to(F64), leave))
        hit = inside & (rays.slabs > 0) & (along < until)
        packet.keep_rays(rays)
        packet.set("along", along)
        packet.set("until", until)
        packet.set("done", (~hit).to(I32))
        packet.set("samples", code.same(I32, 0))
        return code.any(hit)

    def go_on(self, packet: Packet, kept: Variables, last: Value) -> Value:
        """Take a packet's rays through a window, by its last slab; returns the least slab with which one goes on.

        What is visible in a brick is drawn to the end of the window, or of the brick, as one sum: how rays have passed
        what lies before it changes no bit.
        """
        code, blend_mode, rays, until = self._code, self._blend_mode, packet.rays, packet.get("until")
        first, end = (code.splat(slab.to(F64)) for slab in (last - (self._job["window"] - 1), last + 1))
        along, done, samples = (Variable(packet.get(name)) for name in ("along", "done", "samples"))
        # Nothing is visible up to there.
        ahead = Variable(along.now)
        x, y, z = (by.to(F32) for by in rays.slab)

        def active() -> Value:
            return (along.now < until) & done.now.equals(0)

        def in_window() -> Value:
            return active() & (along.now < end)

        with code.loop(lambda: code.any(in_window())):
            here = in_window()
            number, leave = self._faces.bricks_at(rays, along.now)
            leave = code.least(leave, until)
            place = self._faces.position(rays, first), here
            spot, empty_until = self._places.in_brick(self._faces, rays, number, place, (ahead.now, leave))
            gap = here & (empty_until > ahead.now)
            ahead.set(code.select(gap, empty_until, ahead.now))
            along.set(
                code.select(gap, code.least(self._places.next_part(along.now, ahead.now, leave), until), along.now)
            )
            # Rays that have found something wait for those that are still looking.
            with code.when(~code.any(gap & in_window())):
                runs = here & ~gap
                begin = along.now
                to = code.select(runs, code.least(leave, end), begin)
                run, parts = blend_mode.parts(spot, (x, y, z), first, begin, to)
                blend_mode.add(kept, run, runs & (run[3] > 0.0))
                along.set(to)
                ahead.set(code.select(runs, to, ahead.now))
                samples.set(samples.now + parts)
                done.set(code.select(blend_mode.is_done(kept), 1, done.now))
        for name, variable in (("along", along), ("done", done), ("samples", samples)):
            packet.set(name, variable.now)
        return code.smallest(code.select(active(), along.now, float(NEVER)).to(I32))

    def finish(self, packet: Packet, kept: Variables) -> Value:
        """Nothing is left to draw; samples taken in all, int32."""
        return packet.get("samples")

    def _kept(self, rays: Rays) -> tuple[Value, Value]:
        """The slabs that planes keep; the midpoint of a first one that the entry cuts is not on the lattice."""
        code = self._code
        kept_from, kept_to = kept_range(code, self._job, rays)
        if rays.entered is None:
            return kept_from, kept_to
        several, first_kept = rays.slabs > 1, keeps(code, self._job, rays.entered)
        kept_from = code.select(several & kept_from.equals(1) & first_kept, 0, kept_from)
        return kept_from, code.select(several & kept_to.equals(1) & ~first_kept, 0, kept_to)


class BrickPlaces(Places):
    """Places in bricks that are known by their numbers."""

    def in_brick(
        self, faces: Faces, rays: Rays, number: Vector, place: tuple[Vector, Value], reach: tuple[Value, Value]
    ) -> tuple[Spot, Value]:
        """Spots of places, and up to where nothing is visible; not beyond what is known, where something is.

        Parameters
        ----------
        place : of which the spots are, in or near the brick, and the rays for which it is
        reach : up to where nothing is known to be visible, and where rays leave the brick
        """
        code, (ahead, leave) = self._code, reach
        ats = zip(number, self._begin, self._count, strict=True)
        x, y, z = (code.within(at - begin, 0, count - 1) for at, begin, count in ats)
        brick = (z * self._count[1] + y) * self._count[0] + x
        first = number[0] * self._brick, number[1] * self._brick, number[2] * self._brick
        empty_until = self._empty_until(faces, rays, (brick, first), ahead, leave)
        # What rays pass beyond the brick is another one's.
        passed = code.most(ahead + JUST_BEHIND, leave)
        empty_until = code.select(ahead >= leave, passed, empty_until)
        return self._spot(*place, first, self._voxels_of(brick)), empty_until

    def next_part(self, along: Value, ahead: Value, leave: Value) -> Value:
        """With which part of a slab to go on where nothing is visible up to a place.

        Parts do not depend on groups of cells: what is left out ends with whole slabs, or with bricks.
        """
        code, whole = self._code, self._code.call("floor", ahead)
        return code.most(along, code.select(ahead < leave, whole, code.most(whole, leave)))

    def _spot(self, position: Vector, here: Value, first: Vector, voxels: Value) -> Spot:
        code, cells, high = self._code, [], []
        for axis, at in enumerate(position):
            in_brick, in_volume = first[axis] + self._last[axis], self._job.part("cells", axis) - 1
            last = code.least(first[axis] + self._brick - 1, in_volume)
            # Rays that lie nowhere read some cell of the brick, too.
            whole = code.call("floor", at)
            inside = code.within(whole, first[axis].to(F64), last.to(F64))
            cells.append(code.select(here, whole, inside).to(I32))
            # Rays begin and end on the volume's faces, which belong to the cells before them.
            high.append((code.least(in_brick, in_volume) - cells[axis]).to(F32))
        local = [cell - begin for cell, begin in zip(cells, first, strict=True)]
        beyond = [(at - cell.to(F64)).to(F32) for at, cell in zip(position, cells, strict=True)]
        low = [(self._first - at).to(F32) for at in local]
        return Spot(
            voxels + self._voxel(vector_of(local)), vector_of(low), vector_of(high), vector_of(beyond), vector_of(cells)
        )

    def _empty_until(self, faces: Faces, rays: Rays, brick: tuple[Value, Vector], ahead: Value, leave: Value) -> Value:
        """Where rays leave the groups that a skip from a place crosses; the place itself where something is visible."""
        code, (number, first), group, found = self._code, brick, [], self._code.same(F64, FAR)
        for axis, at in enumerate(faces.position(rays, ahead + JUST_BEHIND)):
            inside = code.within(code.call("floor", at - first[axis].to(F64)), 0.0, FARTHEST_CELL)
            group.append(code.least(inside.to(I32) >> GROUP_SHIFT, self._sides[axis] - 1))
        within = (group[2] * self._sides[1] + group[1]) * self._sides[0] + group[0]
        skip = code.gather(I32, self._job["skips"], number * self._sides[3] + within, 4)
        for axis, by in enumerate(rays.slab):
            past = code.select(by > 0.0, group[axis] + skip, group[axis] - skip + 1)
            end = faces.met(rays, axis, first[axis] + (past << GROUP_SHIFT))
            found = code.select(by.equals(0.0), found, code.least(end, found))
        # Where groups are of one size, skips go on into other bricks.
        even = code.splat((self._brick & ((1 << GROUP_SHIFT) - 1)).equals(0).to(I32)) > 0
        found = code.select(skip.equals(WHOLE_BRICK), leave, code.select(even, found, code.least(found, leave)))
        found = code.most(found, ahead + JUST_BEHIND)
        return code.select(skip.equals(0), ahead, found)


FARTHEST_CELL = float(1 << 30)
