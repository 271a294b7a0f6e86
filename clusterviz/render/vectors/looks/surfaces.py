"""Isosurfaces, alone or in a volume: the twin of surfaces.glsl.

One of a slab's two parts has one where the field at its begin and at its end are on different sides of a value. Every
ray of a packet goes on to its next slab with a surface, then they refine theirs together. In a volume, what is in front
of a surface and behind it in its slab is taken apart.
"""

from __future__ import annotations

from dataclasses import dataclass

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, F64, I32, Value, Vector
from clusterviz.render.vectors.fields.field import Spot
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.looks.course import ROW_FLOATS, Course, Courses, Noted
from clusterviz.render.vectors.looks.optics import Optics
from clusterviz.render.vectors.looks.over import put_behind, take_sample, too_little_left
from clusterviz.render.vectors.looks.preintegrated import WITHIN
from clusterviz.render.vectors.looks.relief import Relief
from clusterviz.render.vectors.looks.root import Side, root
from clusterviz.render.vectors.looks.samples import Samples, four, zeros
from clusterviz.render.vectors.marching.clip import Cut, keeps
from clusterviz.render.vectors.marching.march import Four, Variables
from clusterviz.render.vectors.transfer.tables import rows


@dataclass(frozen=True)
class _Slabs:
    """Slabs of rays, one each.

    Attributes
    ----------
    middle : their midpoints
    slab : from one midpoint to the next
    half : their lengths by two, in slabs
    course : the field along them
    """

    middle: Spot
    slab: Vector
    half: Value
    course: Course


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
        self._optics, self._courses, self._rows = optics, Courses(code, job, samples), job["surface"]
        self._stops, self._residual = job.part("optics", 1) > 0.0, code.splat(job.part("optics", 1))

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """The surfaces of the run's slabs, and the volume between them."""
        code, rest, half = self._code, 1.0 - kept[3].now, self._code.same(F32, 0.5)
        begin = code.select(first, code.same(F32, -WITHIN), -0.5)
        noted = Noted(code, self._courses.mark(self._samples.at(self._samples.moved(spot, slab, begin))))
        at, end, found = Variable(code.same(I32, 0)), Variable(slabs), Variable(code.same(I32, 0))
        with code.loop(lambda: code.any(at.now < end.now)):
            found.set(code.same(I32, 0))
            with code.loop(lambda: code.any((at.now < end.now) & found.now.equals(0))):
                looking = (at.now < end.now) & found.now.equals(0)
                middle = self._samples.moved(spot, slab, at.now.to(F32))
                behind = self._samples.on_the_way(spot, slab, at.now.to(F32) + 0.5)
                course = self._courses.of((middle, slab), half, noted.now.back, behind, looking)
                noted.note(course, looking)
                crosses = looking & (_sum(self._courses.crossed(course)) > 0)
                self._take_whole(sums, _Slabs(middle, slab, half, course), at.now, looking & ~crosses)
                found.set(code.select(crosses, 1, found.now))
                at.set(code.select(looking, at.now + 1, at.now))
            with code.when(code.any(found.now > 0)):
                middle = self._samples.moved(spot, slab, (at.now - 1).to(F32))
                self._take_slabs(sums, _Slabs(middle, slab, half, noted.now), at.now - 1, found.now > 0)
            with code.when(self._stops):
                # A ray ends with the slab that leaves too little light, not with its run.
                ended = rest * (1.0 - sums[3].now) <= self._residual
                end.set(code.select(ended, code.least(at.now, end.now), end.now))
        return end.now

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab, around its midpoint: taken as one with a surface."""
        code, sums, half = self._code, zeros(self._code), 0.5 * share
        begin = code.select(only, code.same(F32, -WITHIN), -0.5) * share
        front, behind = (self._samples.at(self._samples.moved(spot, slab, at)) for at in (begin, WITHIN * share))
        course = self._courses.of((spot, slab), half, self._courses.mark(front), behind, drawn)
        self._take_slabs(sums, _Slabs(spot, slab, half, course), code.same(I32, 0), drawn)
        return four(sums)

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Behind what is there."""
        put_behind(self._code, kept, run, drawn)

    def is_done(self, kept: Variables) -> Value:
        """Where so little light is left that the scene allows to stop."""
        return too_little_left(kept, self._residual)

    def _take_whole(self, sums: Variables, slabs: _Slabs, number: Value, drawn: Value) -> None:
        """The volume in slabs without a surface."""
        if self._optics is None:
            return
        s = slabs.course.middle
        seen = drawn & self._cut.keeps(number) & (s >= self._optics.visible_from)
        with self._code.when(self._code.any(seen)):
            found = self._optics.of_slab(s, slabs.middle, slabs.slab)
            take_sample(self._code, sums, seen, found.opacity, found.colour)

    def _take_slabs(self, sums: Variables, slabs: _Slabs, number: Value, drawn: Value) -> None:
        """The surfaces of slabs, front to back, and the volume between them."""
        code, course = self._code, slabs.course
        first, second = (code.select(drawn, count, 0) for count in self._courses.crossed(course))
        begin, at_begin, nth = Variable(-slabs.half), Variable(course.front.s), Variable(code.number(I32, 0))
        # In a volume, what is behind the last surface comes last.
        rounds = code.largest(first + second) + int(self._optics is not None)
        with code.loop(lambda: nth.now < rounds):
            crossed, is_second = drawn & (nth.now < first + second), nth.now >= first
            surface = _surface(code, course, code.select(is_second, nth.now - first, nth.now), is_second)
            value, _, _, _, r, g, b, opacity = rows(code, self._rows, code.select(crossed, surface, 0), ROW_FLOATS)
            at_begin.set(code.select(first.equals(nth.now), course.at_turn.s, at_begin.now))
            low = code.select(is_second, code.most(begin.now, course.turn), begin.now)
            high = code.select(is_second, slabs.half, course.turn)
            at_high = code.select(is_second, course.back.s, course.at_turn.s)
            sides = Side(low, at_begin.now - value), Side(high, at_high - value)
            found, met = root(code, self._samples, (slabs.middle, slabs.slab), value, sides, crossed)
            ends = drawn & (first + second).equals(nth.now)
            length = code.select(ends, slabs.half, found) - begin.now
            self._take_between(sums, slabs, length, (met | ends) & self._cut.keeps(number))
            begin.set(code.select(met, found, begin.now))
            at_begin.set(code.select(met, value, at_begin.now))
            self._take_surface(sums, slabs, begin.now, met, (r, g, b), opacity)
            nth.set(nth.now + 1)

    def _take_between(self, sums: Variables, slabs: _Slabs, length: Value, drawn: Value) -> None:
        """Parts of slabs in the volume, so long, as their midpoints are; of surfaces alone nothing."""
        if self._optics is None:
            return
        s = slabs.course.middle
        found = self._optics.of_share(s, length, slabs.middle, slabs.slab)
        take_sample(self._code, sums, drawn & (s >= self._optics.visible_from), found.opacity, found.colour)

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


def _surface(code: Code, course: Course, nth: Value, is_second: Value) -> Value:
    """Which surface is the n-th that a part of slabs crosses."""
    front = code.select(is_second, course.at_turn.reached, course.front.reached)
    back = code.select(is_second, course.back.reached, course.at_turn.reached)
    return code.select(back > front, front + nth, front - 1 - nth)


def _sum(counts: tuple[Value, Value]) -> Value:
    return counts[0] + counts[1]
