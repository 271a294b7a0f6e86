"""The march of packets of rays from run to run: the twin of march.glsl.

Each ray has its own lattice and its own runs; the rays of a packet take their next runs together. What a run comes to
is the look's (`BlendMode`).

Rays are cut into windows of a fixed number of slabs. Places in a window are counted in float32 from its first midpoint,
and what its runs come to is summed by itself before it is put behind what is kept. So neither where runs begin nor how
many there are changes a bit: pictures are the same with or without skipping what is empty.
"""

from __future__ import annotations

from typing import Protocol

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.fields.field import Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.adaptive_step import Stretch
from clusterviz.render.cpu.marching.clip import Cut, keeps, kept_range
from clusterviz.render.cpu.marching.rays import Rays, cell_of, midpoint, owned, owned_range, packet_rays
from clusterviz.render.cpu.marching.sample_positions import Place, Places
from clusterviz.render.cpu.marching.starts import Starts
from clusterviz.render.cpu.marching.state import NEVER, STARTED, Layout, Packet
from clusterviz.render.cpu.marching.volume_bounds import Bodies

Four = tuple[Value, Value, Value, Value]
Variables = list[Variable]
CHANNELS = 4

KEPT: Layout = (("kept_from", I32, 1), ("kept_to", I32, 1))
"""The slabs whose midpoints clipping planes keep, where slabs are not kept as wholes."""


class AsyncCompositing(Protocol):
    """How what rays come to is put behind what lies in front of it.

    What is kept of a packet are `LOOK_VECTORS` vectors, zeros at first; four of them are the pixels, whose meaning is
    said in image/merge.py.
    """

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Put what windows or runs come to behind what is kept, where it is drawn."""

    def is_done(self, kept: Variables) -> Value:
        """Where nothing behind can matter."""


class BlendMode(AsyncCompositing, Protocol):
    """What becomes of the samples of rays."""

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """Take runs of whole slabs; how many slabs were taken.

        Parameters
        ----------
        kept : what lies in front; a run may end early where nothing behind can matter
        sums : what their windows have come to so far, zeros at first, as if nothing were in front of them; changed
        spot : slabs are counted from the first midpoint
        slab : from one midpoint to the next
        slabs : how many, of each ray; none where 0
        first : whether the run begins with the ray's first slab
        """

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """What shares of slabs come to, where they are drawn; `only`: the ray has no other slab."""


class March:
    """The march of a kernel.

    Parameters
    ----------
    jittered : every pixel has a lattice of slabs of its own
    stretch : where slabs may be longer; None: nowhere
    cut : what clipping planes keep of slabs; None: they are kept as wholes
    starts : where rays start; None: at their first slab
    bodies : several volumes; None: there is one
    """

    def __init__(
        self,
        code: Code,
        job: Job,
        places: Places,
        blend_mode: BlendMode,
        jittered: bool = False,
        stretch: Stretch | None = None,
        cut: Cut | None = None,
        starts: Starts | None = None,
        bodies: Bodies | None = None,
    ) -> None:
        self._code, self._job, self._places, self._blend_mode = code, job, places, blend_mode
        self._jittered, self._stretch, self._cut, self._starts, self._bodies = jittered, stretch, cut, starts, bodies

    @property
    def keeps_more(self) -> Layout:
        """What is kept of a packet beside what is of every one."""
        of_volumes = self._bodies.layout if self._bodies else ()
        return (KEPT if self._cut else ()) + (STARTED if self._starts else ()) + of_volumes

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
        if self._bodies:
            self._bodies.begin(packet, rays)
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
            window = self._places.window(rays.entered, mine)
            place = self._places.of(window, rays.entered, code.same(F32, 0.0), slab, _inverse(code, slab))
            seen, kept = mine & place.visible, packet.blend_mode
            spot = self._places.spot(place, window)
            if self._bodies:
                self._bodies.enter(packet, rays)
            share = self._blend_mode.last(spot, slab, rays.first_share, seen, code.same(I32, 0) > 0)
            self._blend_mode.add(kept, share, seen & (share[3] > 0.0))
            packet.set("samples", seen.to(I32))
            packet.set("done", code.select(self._blend_mode.is_done(kept), 1, packet.get("done")))
            packet.keep_look(kept)

    def go_on(self, packet: Packet, kept: Variables, last: Value) -> Value:
        """Take a packet's rays through a window, by its last slab; returns the least slab with which one goes on."""
        code, rays, first = self._code, packet.rays, last - (self._job["window"] - 1)
        slab = _float(rays.slab)
        per_slab = _inverse(code, slab)
        at, done, samples = (Variable(packet.get(name)) for name in ("at", "done", "samples"))
        behind, ahead = packet.get("behind"), self._starts.ahead(packet) if self._starts else None
        sums = [Variable(code.same(F32, 0.0)) for _ in range(CHANNELS)]

        def active() -> Value:
            return (at.now < behind) & done.now.equals(0)

        def in_window() -> Value:
            return active() & (at.now >= first) & (at.now <= last)

        window = self._places.window(midpoint(code, rays, code.splat(first)), in_window())
        with code.loop(lambda: code.any(in_window())):
            here, stopped = in_window(), Variable(code.same(I32, 0))
            along = code.select(here, at.now - first, 0).to(F32)
            place = self._places.of(window, midpoint(code, rays, at.now), along, slab, per_slab)
            step = code.least(place.slabs, behind - at.now)
            if ahead:
                step = ahead.reached(at.now, step, code.fma(1.0 - kept[3].now, sums[3].now, kept[3].now))
            gap = here & ~place.visible
            at.set(code.select(gap, at.now + step, at.now))
            # Rays that have found something wait for those that are still looking.
            with code.when(~code.any(gap & (at.now < behind) & (at.now <= last))):
                slabs = code.select(here & place.visible, code.least(step, last + 1 - at.now), 0)
                self._tell(packet, at.now)
                taken, sampled, short = self._run(
                    kept, sums, self._places.spot(place, window, along), place, (slab, slabs, at.now)
                )
                on = at.now + taken
                if ahead:
                    late = ahead.passed(at.now, slabs > 0)
                    on = code.select(late, ahead.entry, on)
                    _clear(code, sums, late)
                at.set(on)
                samples.set(samples.now + sampled)
                stopped.set(short.to(I32))
            left = here & ((at.now > last) | (at.now >= behind) | (stopped.now > 0))
            self._put_behind(kept, sums, left, done)
        for name, variable in (("at", at), ("done", done), ("samples", samples)):
            packet.set(name, variable.now)
        if ahead:
            ahead.keep(packet)
        return code.smallest(code.select(active(), at.now, NEVER))

    def _run(
        self, kept: Variables, sums: Variables, spot: Spot, place: Place, slabs: tuple[Vector, Value, Value]
    ) -> tuple[Value, Value, Value]:
        """Take runs; how many slabs were taken, how many samples, and which rays ended early.

        Parameters
        ----------
        slabs : from one midpoint to the next, how many, and the first one's number
        """
        slab, count, at = slabs
        if self._stretch is None or place.doublings is None:
            taken = self._blend_mode.run(kept, sums, spot, slab, count, at.equals(0))
            return taken, taken, taken < count
        stretches = self._stretch.stretches(self._stretch.take(at, count, place.doublings))
        spot, slab = self._stretch.longer(spot, slab)
        taken = self._blend_mode.run(kept, sums, spot, slab, stretches, at.equals(0))
        return self._stretch.slabs(taken), taken, taken < stretches

    def _put_behind(self, kept: Variables, sums: Variables, left: Value, done: Variable) -> None:
        """Put windows that rays have left behind what is kept: not those that came to nothing, which changes no bit."""
        code = self._code
        some = left & (sums[3].now > 0.0)
        with code.when(code.any(some)):
            r, g, b, a = (part.now for part in sums)
            self._blend_mode.add(kept, (r, g, b, a), some)
            _clear(code, sums, some)
            done.set(code.select(self._blend_mode.is_done(kept), 1, done.now))

    def _tell(self, packet: Packet, at: Value) -> None:
        """Tell what planes keep, and volumes hold, of the slabs from some numbers on."""
        if self._cut:
            self._cut.take(packet.get("kept_from") - at, packet.get("kept_to") - at)
        if self._bodies:
            self._bodies.take(packet, at)

    def finish(self, packet: Packet, kept: Variables) -> Value:
        """Draw the last slabs, where the box owns them and something may be visible; samples taken in all, int32."""
        code, job = self._code, self._job
        rays = packet.rays
        drawn = Variable(code.same(I32, 0))
        mine = packet.get("done").equals(0) & packet.mask("ends") & owned(job, cell_of(code, job, rays.last))
        with code.when(code.any(mine)):
            slab = _float(rays.slab)
            window = self._places.window(rays.last, mine)
            place = self._places.of(window, rays.last, code.same(F32, 0.0), slab, _inverse(code, slab))
            seen = mine & place.visible
            self._tell(packet, rays.slabs - 1)
            if self._bodies:
                self._bodies.end(rays)
            drawn.set(seen.to(I32))
            spot = self._places.spot(place, window)
            share = self._blend_mode.last(spot, slab, rays.last_share, seen, rays.slabs.equals(1))
            found = seen & (share[3] > 0.0)
            self._blend_mode.add(kept, share, found)
            if self._starts:
                self._starts.end(packet, found)
        return packet.get("samples") + drawn.now


def _clear(code: Code, sums: Variables, where: Value) -> None:
    for part in sums:
        part.set(code.select(where, 0.0, part.now))


def _float(vector: Vector) -> Vector:
    x, y, z = (by.to(F32) for by in vector)
    return x, y, z


def _inverse(code: Code, slab: Vector) -> Vector:
    x, y, z = (1.0 / code.most(code.size(by), 1e-30) for by in slab)
    return x, y, z
