"""Isosurfaces, alone or in a volume: the twin of surfaces.glsl.

A slab has one where the field at its begin and at its end are on different sides of a value. Every ray of a packet goes
on to its next slab with a surface, then they refine theirs together. In a volume, what is in front of a surface and
behind it in its slab is taken apart.

Surfaces stand in the order of their values, so how many of them a scalar reaches says between which it lies.
"""

from __future__ import annotations

from dataclasses import dataclass

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, F64, I32, I64, Value, Vector
from clusterviz.render.vectors.fields.field import Spot
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.looks.optics import Optics
from clusterviz.render.vectors.looks.over import put_behind, take_sample, too_little_left
from clusterviz.render.vectors.looks.preintegrated import WITHIN
from clusterviz.render.vectors.looks.relief import Relief
from clusterviz.render.vectors.looks.root import Side, root
from clusterviz.render.vectors.looks.samples import LARGEST, Samples, four, zeros
from clusterviz.render.vectors.marching.clip import Cut, keeps
from clusterviz.render.vectors.marching.march import Four, Variables
from clusterviz.render.vectors.transfer.tables import rows

ROW_FLOATS = 8  # value, 0, 0, 0; colour, opacity: a surface's two rows of plan/look.py


@dataclass(frozen=True)
class _End:
    """One end of slabs.

    Attributes
    ----------
    s : the scalar
    reached : surfaces whose value is not above it
    """

    s: Value
    reached: Value


@dataclass(frozen=True)
class _Slabs:
    """Slabs of rays, one each.

    Attributes
    ----------
    middle : their midpoints
    slab : from one midpoint to the next
    half : their lengths by two, in slabs
    front, back : their ends
    """

    middle: Spot
    slab: Vector
    half: Value
    front: _End
    back: _End


class Surfaces:
    """Isosurfaces; a `Look`.

    Parameters
    ----------
    relief : what depends on the gradient
    cut : what clipping planes keep
    optics : of the volume in which they stand; None where they are alone
    """

    def __init__(
        self, code: Code, job: Job, samples: Samples, relief: Relief, cut: Cut, optics: Optics | None = None
    ) -> None:
        self._code, self._job, self._samples, self._relief, self._cut = code, job, samples, relief, cut
        self._optics = optics
        self._rows, self._count = job["surface"], job["surfaces"]
        self._stops, self._residual = job.part("optics", 1) > 0.0, code.splat(job.part("optics", 1))

    def run(self, kept: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> tuple[Four, Value]:
        """The surfaces of the run's slabs, and the volume between them."""
        code, rest, sums = self._code, 1.0 - kept[3].now, zeros(self._code)
        begin = code.select(first, code.same(F32, -WITHIN), -0.5)
        front, back = (_Kept(self._end(self._samples.at(self._samples.moved(spot, slab, begin)))) for _ in range(2))
        at, end, found = Variable(code.same(I32, 0)), Variable(slabs), Variable(code.same(I32, 0))
        with code.loop(lambda: code.any(at.now < end.now)):
            found.set(code.same(I32, 0))
            with code.loop(lambda: code.any((at.now < end.now) & found.now.equals(0))):
                looking = (at.now < end.now) & found.now.equals(0)
                behind = self._end(self._samples.on_the_way(spot, slab, at.now.to(F32) + 0.5))
                front.keep(code, back.end, looking)
                back.keep(code, behind, looking)
                crosses = looking & self._crosses(front.end, behind)
                self._take_whole(sums, spot, slab, at.now, looking & ~crosses)
                found.set(code.select(crosses, 1, found.now))
                at.set(code.select(looking, at.now + 1, at.now))
            with code.when(code.any(found.now > 0)):
                middle = self._samples.moved(spot, slab, (at.now - 1).to(F32))
                half = code.same(F32, 0.5)
                slabs_now = _Slabs(middle, slab, half, front.end, back.end)
                self._take_slabs(sums, slabs_now, self._cut.keeps(at.now - 1), found.now > 0)
            with code.when(self._stops):
                # A ray ends with the slab that leaves too little light, not with its run.
                ended = rest * (1.0 - sums[3].now) <= self._residual
                end.set(code.select(ended, code.least(at.now, end.now), end.now))
        return four(sums), end.now

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab, around its midpoint: taken as one with a surface."""
        code, sums = self._code, zeros(self._code)
        begin = code.select(only, code.same(F32, -WITHIN), -0.5) * share
        ends = [self._end(self._samples.at(self._samples.moved(spot, slab, at))) for at in (begin, WITHIN * share)]
        slabs = _Slabs(spot, slab, 0.5 * share, ends[0], ends[1])
        self._take_slabs(sums, slabs, self._cut.keeps(code.same(I32, 0)), drawn)
        return four(sums)

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Behind what is there."""
        put_behind(self._code, kept, run, drawn)

    def is_done(self, kept: Variables) -> Value:
        """Where so little light is left that the scene allows to stop."""
        return too_little_left(kept, self._residual)

    def _end(self, s: Value) -> _End:
        code, reached, number = self._code, Variable(self._code.same(I32, 0)), Variable(self._code.number(I32, 0))
        with code.loop(lambda: number.now < self._count):
            value = code.splat(code.load(F32, self._rows + number.now.to(I64) * (4 * ROW_FLOATS)))
            reached.set(code.select(s >= value, reached.now + 1, reached.now))
            number.set(number.now + 1)
        return _End(s, reached.now)

    def _crosses(self, front: _End, back: _End) -> Value:
        return ~front.reached.equals(back.reached) & self._are_valid(front, back)

    def _are_valid(self, front: _End, back: _End) -> Value:
        code = self._code
        # NaN compares false.
        return (code.size(front.s) <= LARGEST) & (code.size(back.s) <= LARGEST)

    def _take_whole(self, sums: Variables, spot: Spot, slab: Vector, number: Value, drawn: Value) -> None:
        """The volume in slabs without a surface."""
        if self._optics is None:
            return
        seen = drawn & self._cut.keeps(number)
        with self._code.when(self._code.any(seen)):
            middle = self._samples.moved(spot, slab, number.to(F32))
            s = self._samples.at(middle)
            seen = seen & (s >= self._optics.visible_from)
            with self._code.when(self._code.any(seen)):
                found = self._optics.of_slab(s, middle, slab)
                take_sample(self._code, sums, seen, found.opacity, found.colour)

    def _take_slabs(self, sums: Variables, slabs: _Slabs, volume_kept: Value, drawn: Value) -> None:
        """The surfaces of slabs, front to back, and the volume between them where its midpoint is kept."""
        code, front, back = self._code, slabs.front, slabs.back
        rises = back.s > front.s
        count = code.select(drawn & self._are_valid(front, back), _distance(code, front.reached, back.reached), 0)
        begin, at_begin = Variable(-slabs.half), Variable(front.s)
        between = _Between(self._code, self._samples, self._optics, slabs, drawn & volume_kept)
        number = Variable(code.number(I32, 0))
        # In a volume, what is behind the last surface comes last.
        rounds = code.largest(count) + int(self._optics is not None)
        with code.loop(lambda: number.now < rounds):
            crossed = number.now < count
            surface = code.select(rises, front.reached + number.now, front.reached - 1 - number.now)
            value, _, _, _, *look = rows(code, self._rows, code.select(crossed, surface, 0), ROW_FLOATS)
            sides = Side(begin.now, at_begin.now - value), Side(slabs.half, back.s - value)
            found, met = root(code, self._samples, (slabs.middle, slabs.slab), value, sides, crossed)
            behind = drawn & count.equals(number.now)
            between.take(sums, code.select(behind, slabs.half, found) - begin.now, met | behind)
            begin.set(code.select(met, found, begin.now))
            at_begin.set(code.select(met, value, at_begin.now))
            self._take_surface(sums, slabs, begin.now, met, (look[0], look[1], look[2]), look[3])
            number.set(number.now + 1)

    def _take_surface(
        self, sums: Variables, slabs: _Slabs, along: Value, met: Value, colour: Vector, opacity: Value
    ) -> None:
        code = self._code
        at = self._samples.moved(slabs.middle, slabs.slab, along)
        x, y, z = (cell.to(F64) + beyond.to(F64) for cell, beyond in zip(at.cell, at.beyond, strict=True))
        seen = met & keeps(code, self._job, (x, y, z))
        with code.when(code.any(seen)):
            lit = self._relief.lit(colour, self._relief.gradient(at), at, slabs.slab)
            take_sample(code, sums, seen, opacity, lit)


class _Between:
    """The volume between the surfaces of slabs, sampled at their midpoints; of surfaces alone nothing."""

    def __init__(self, code: Code, samples: Samples, optics: Optics | None, slabs: _Slabs, drawn: Value) -> None:
        self._code, self._optics, self._slabs = code, optics, slabs
        if optics is not None:
            self._s = samples.at(slabs.middle)
            self._seen = drawn & (self._s >= optics.visible_from)

    def take(self, sums: Variables, length: Value, wanted: Value) -> None:
        """Parts of slabs, so long, behind what is there."""
        if self._optics is None:
            return
        found = self._optics.of_share(self._s, length, self._slabs.middle, self._slabs.slab)
        take_sample(self._code, sums, self._seen & wanted, found.opacity, found.colour)


class _Kept:
    """An end that loops change."""

    def __init__(self, end: _End) -> None:
        self._s, self._reached = Variable(end.s), Variable(end.reached)

    @property
    def end(self) -> _End:
        """As it is now."""
        return _End(self._s.now, self._reached.now)

    def keep(self, code: Code, end: _End, where: Value) -> None:
        """Change it for some rays."""
        self._s.set(code.select(where, end.s, self._s.now))
        self._reached.set(code.select(where, end.reached, self._reached.now))


def _distance(code: Code, a: Value, b: Value) -> Value:
    return code.select(a < b, b - a, a - b)
