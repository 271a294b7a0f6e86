"""The march of packets of rays from run to run: the twin of march.glsl.

Each ray has its own lattice and its own runs; the rays of a packet take their next runs together. What a run comes to
is the look's (`Look`).
"""

from __future__ import annotations

from typing import Protocol

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.vectors.fields.field import Spot
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.marching.clip import Cut, keeps, kept_range
from clusterviz.render.vectors.marching.place import Place, Places
from clusterviz.render.vectors.marching.rays import Rays, cell_of, midpoint, owned, owned_range, packet_rays
from clusterviz.render.vectors.marching.starts import Starts
from clusterviz.render.vectors.marching.state import NEVER, STARTED, Layout, Packet
from clusterviz.render.vectors.marching.stretch import Stretch

Four = tuple[Value, Value, Value, Value]
Variables = list[Variable]

KEPT: Layout = (("kept_from", I32, 1), ("kept_to", I32, 1))
"""The slabs whose midpoints clipping planes keep, where slabs are not kept as wholes."""


class Look(Protocol):
    """What becomes of the samples of rays.

    What it keeps of a packet are `LOOK_VECTORS` vectors, zeros at first; four of them are the pixels, whose meaning is
    said in image/merge.py.
    """

    def run(self, kept: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> tuple[Four, Value]:
        """What runs of whole slabs come to, as if nothing were in front of them, and how many slabs were taken.

        Parameters
        ----------
        kept : what lies in front; a run may end early where nothing behind can matter
        spot : of the first midpoint
        slab : from one midpoint to the next
        slabs : how many, of each ray; none where 0
        first : whether the run begins with the ray's first slab
        """

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """What shares of slabs come to, where they are drawn; `only`: the ray has no other slab."""

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Put a run behind what is kept, where it is drawn."""

    def is_done(self, kept: Variables) -> Value:
        """Where nothing behind can matter."""


class March:
    """The march of a kernel.

    Parameters
    ----------
    jittered : every pixel has a lattice of slabs of its own
    stretch : where slabs may be longer; None: nowhere
    cut : what clipping planes keep of slabs; None: they are kept as wholes
    starts : where rays start; None: at their first slab
    """

    def __init__(
        self,
        code: Code,
        job: Job,
        places: Places,
        look: Look,
        jittered: bool = False,
        stretch: Stretch | None = None,
        cut: Cut | None = None,
        starts: Starts | None = None,
    ) -> None:
        self._code, self._job, self._places, self._look = code, job, places, look
        self._jittered, self._stretch, self._cut, self._starts = jittered, stretch, cut, starts

    @property
    def keeps_more(self) -> Layout:
        """What is kept of a packet beside what is of every one."""
        return (KEPT if self._cut else ()) + (STARTED if self._starts else ())

    def rays_through(self, x: Value, y: Value) -> Rays:
        """The rays through the pixels (x, y) of the picture."""
        return packet_rays(self._code, self._job, x, y, self._jittered)

    def begin(self, packet: Packet, rays: Rays, inside: Value) -> Value:
        """Write a packet's first state; `inside` says which lanes are pixels. Returns whether there is any slab."""
        code, job = self._code, self._job
        end = code.most(rays.slabs - 1, 0)
        first, behind = Variable(code.same(I32, 0)), Variable(end)
        with code.when(job["whole"].equals(0)):
            begin, past = owned_range(code, job, rays, end)
            first.set(begin)
            behind.set(past)
        kept_from, kept_to = kept_range(code, job, rays)
        if self._cut:
            packet.set("kept_from", kept_from)
            packet.set("kept_to", kept_to)
            kept_from, kept_to = kept_from - 1, code.least(kept_to + 1, rays.slabs)
        first.set(code.most(first.now, kept_from))
        behind.set(code.least(behind.now, kept_to))
        hit = inside & (rays.slabs > 0)
        packet.set("ends", kept_to.equals(rays.slabs).to(I32))
        packet.keep_rays(rays)
        packet.set("at", first.now)
        packet.set("behind", code.select(hit, behind.now, 0))
        packet.set("done", (~hit).to(I32))
        packet.set("samples", code.same(I32, 0))
        if self._jittered:
            self._enter(packet, rays, hit)
        return code.any(hit)

    def _enter(self, packet: Packet, rays: Rays, hit: Value) -> None:
        """Draw first slabs that the entry cuts, where the box owns them: not those that are the last ones, too."""
        code, job = self._code, self._job
        assert rays.entered is not None, "the lattice begins with the volume"
        assert rays.first_share is not None, "the lattice begins with the volume"
        packet.set("at", code.most(packet.get("at"), 1))
        mine = hit & (rays.slabs > 1) & owned(job, cell_of(code, job, rays.entered)) & keeps(code, job, rays.entered)
        with code.when(code.any(mine)):
            slab = _float(rays.slab)
            place = self._places.of(rays.entered, slab, _inverse(code, slab))
            seen, kept = mine & place.visible, packet.look
            self._look.add(kept, self._look.last(place.spot, slab, rays.first_share, seen, code.same(I32, 0) > 0), seen)
            packet.set("samples", seen.to(I32))
            packet.set("done", code.select(self._look.is_done(kept), 1, packet.get("done")))
            packet.keep_look(kept)

    def go_on(self, packet: Packet, kept: Variables, limit: Value) -> Value:
        """Take a packet's rays up to a slab at least; returns the least slab with which one goes on."""
        code, look = self._code, self._look
        rays = packet.rays
        slab = _float(rays.slab)
        per_slab = _inverse(code, slab)
        at, done, samples = (Variable(packet.get(name)) for name in ("at", "done", "samples"))
        behind, ahead = packet.get("behind"), self._starts.ahead(packet) if self._starts else None

        def active() -> Value:
            return (at.now < behind) & done.now.equals(0)

        with code.loop(lambda: code.any(active() & (at.now < limit))):
            here = active()
            place = self._places.of(midpoint(code, rays, at.now), slab, per_slab)
            step = code.least(place.slabs, behind - at.now)
            if ahead:
                step = ahead.reached(at.now, step, kept[3].now)
            gap = here & ~place.visible
            at.set(code.select(gap, at.now + step, at.now))
            # Rays that have found something wait for those that are still looking.
            with code.when(~code.any(gap & (at.now < behind))):
                slabs = code.select(here & place.visible, step, 0)
                self._tell_cut(packet, at.now)
                run, taken, sampled = self._run(kept, place, slab, slabs, at.now)
                drawn, on = slabs > 0, at.now + taken
                if ahead:
                    late = ahead.passed(at.now, drawn)
                    drawn, on = drawn & ~late, code.select(late, ahead.entry, on)
                look.add(kept, run, drawn)
                at.set(on)
                samples.set(samples.now + sampled)
                done.set(code.select(look.is_done(kept), 1, done.now))
        for name, variable in (("at", at), ("done", done), ("samples", samples)):
            packet.set(name, variable.now)
        if ahead:
            ahead.keep(packet)
        return code.smallest(code.select(active(), at.now, NEVER))

    def _run(self, kept: Variables, place: Place, slab: Vector, slabs: Value, at: Value) -> tuple[Four, Value, Value]:
        """What runs come to, how many slabs were taken, and how many samples."""
        first = at.equals(0)
        if self._stretch is None or place.doublings is None:
            run, taken = self._look.run(kept, place.spot, slab, slabs, first)
            return run, taken, taken
        some = self._stretch.take(at, slabs, place.doublings)
        spot, slab = self._stretch.longer(place.spot, slab)
        run, taken = self._look.run(kept, spot, slab, self._stretch.stretches(some), first)
        return run, self._stretch.slabs(taken), taken

    def _tell_cut(self, packet: Packet, at: Value) -> None:
        """Tell what planes keep of the slabs from some numbers on."""
        if self._cut:
            self._cut.take(packet.get("kept_from") - at, packet.get("kept_to") - at)

    def finish(self, packet: Packet, kept: Variables) -> Value:
        """Draw the last slabs, where the box owns them and something may be visible; samples taken in all, int32."""
        code, job = self._code, self._job
        rays = packet.rays
        drawn = Variable(code.same(I32, 0))
        mine = packet.get("done").equals(0) & packet.mask("ends") & owned(job, cell_of(code, job, rays.last))
        with code.when(code.any(mine)):
            slab = _float(rays.slab)
            place = self._places.of(rays.last, slab, _inverse(code, slab))
            seen = mine & place.visible
            self._tell_cut(packet, rays.slabs - 1)
            drawn.set(seen.to(I32))
            last = self._look.last(place.spot, slab, rays.last_share, seen, rays.slabs.equals(1))
            self._look.add(kept, last, seen)
            if self._starts:
                self._starts.end(packet, seen & (last[3] > 0.0))
        return packet.get("samples") + drawn.now


def _float(vector: Vector) -> Vector:
    x, y, z = (by.to(F32) for by in vector)
    return x, y, z


def _inverse(code: Code, slab: Vector) -> Vector:
    x, y, z = (1.0 / code.most(code.size(by), 1e-30) for by in slab)
    return x, y, z
