"""Isosurfaces, alone or in a volume: the twin of surfaces.glsl.

Cell after cell, whatever the slabs are: most have no surface between their least and their largest scalar. Every ray of
a packet goes on to its next cell that it meets one in, then they refine theirs together. A surface belongs to the slab
that holds its place. In a volume, slabs are taken up to it; what is in front of it in its slab, and behind it, is taken
apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, F64, I32, Value, Vector
from clusterviz.render.cpu.blending.cells import ROW_FLOATS, Cells, Courses, Mark, Noted, crossed
from clusterviz.render.cpu.blending.classified import GradientShading, Optics
from clusterviz.render.cpu.blending.composite import put_behind, take_sample, too_little_left
from clusterviz.render.cpu.blending.crossings import Search, root
from clusterviz.render.cpu.blending.samples import Samples, four, zeros
from clusterviz.render.cpu.fields.cubic import CubicField
from clusterviz.render.cpu.fields.field import Field, Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.clip import Cut, keeps
from clusterviz.render.cpu.marching.march import Four, Variables
from clusterviz.render.cpu.transfer.classify import rows


@dataclass(frozen=True)
class _Slabs:
    """Slabs of rays, one after another.

    Attributes
    ----------
    spot, slab : from where, and which way, places along them are counted
    first : where the first midpoint is
    half : their lengths by two
    count : how many of each ray
    """

    spot: Spot
    slab: Vector
    first: Value
    half: Value
    count: Value

    @property
    def line(self) -> tuple[Spot, Vector]:
        """The first two."""
        return self.spot, self.slab

    def middle(self, at: Value) -> Value:
        """Where the midpoint of one of them is."""
        return self.first + at.to(F32)

    def begin(self, at: Value) -> Value:
        """Where one begins, and the one before it ends."""
        return self.first + (2.0 * at.to(F32) - 1.0) * self.half

    def number(self, place: Value) -> Value:
        """Which of them holds a place."""
        return ((place - self.first) / self.half * 0.5 + 0.5).to(I32)


class Surfaces:
    """Isosurfaces; a `BlendMode`.

    Parameters
    ----------
    field : in which they are
    relief : what depends on the gradient
    cut : what clipping planes keep
    optics : of the volume in which they stand; None where they are alone
    """

    def __init__(
        self,
        code: Code,
        job: Job,
        field: Field,
        samples: Samples,
        relief: GradientShading,
        cut: Cut,
        optics: Optics | None = None,
    ) -> None:
        self._code, self._job, self._field, self._samples, self._relief = code, job, field, samples, relief
        self._cut, self._optics = cut, optics
        self._courses, self._rows = Courses(code, job, samples, isinstance(field, CubicField)), job["surface"]
        self._stops, self._residual = job.part("optics", 1) > 0.0, code.splat(job.part("optics", 1))

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """The surfaces of the run's slabs, and the volume between them."""
        code, begin = self._code, spot.begin if spot.begin is not None else self._code.same(F32, 0.0)
        run = _Slabs(replace(spot, begin=None), slab, begin, code.same(F32, 0.5), slabs)
        return self._taken(sums, run, 1.0 - kept[3].now, True)

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab, around its midpoint."""
        code, sums = self._code, zeros(self._code)
        one = _Slabs(spot, slab, code.same(F32, 0.0), 0.5 * share, drawn.to(I32))
        self._taken(sums, one, code.same(F32, 1.0), False)
        return four(sums)

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Behind what is there."""
        put_behind(self._code, kept, run, drawn)

    def is_done(self, kept: Variables) -> Value:
        """Where so little light is left that the scene allows to stop."""
        return too_little_left(kept, self._residual)

    def _taken(self, sums: Variables, slabs: _Slabs, rest: Value, whole: bool) -> Value:
        """Take slabs; how many were taken.

        Parameters
        ----------
        rest : what light is left in front of them
        whole : they are no shares of slabs
        """
        code, end, looking = self._code, Variable(slabs.count), Variable((slabs.count > 0).to(I32))
        begin = slabs.begin(code.same(I32, 0))
        search = Search(code, self._courses, Cells(code, self._job, self._field, slabs.line, begin))
        volume = _Volume(code, slabs, sums, self._samples, self._cut, self._optics, whole)
        with code.loop(lambda: code.any(looking.now > 0)):
            found = search.go_on(self._samples, slabs.line, slabs.begin(slabs.count), looking.now > 0)
            looking.set(found.to(I32))
            with code.when(code.any(found)):
                place = self._take_cell(sums, slabs, search.noted, found, volume)
                with code.when(self._stops):
                    # A ray ends with the slab that leaves too little light, not with its run.
                    ended = found & (rest * (1.0 - sums[3].now) <= self._residual)
                    end.set(code.select(ended, code.least(slabs.number(place) + 1, end.now), end.now))
                    looking.set((found & ~ended).to(I32))
        volume.take_to(slabs.begin(end.now), slabs.count > 0)
        return end.now

    def _take_cell(self, sums: Variables, slabs: _Slabs, noted: Noted, found: Value, volume: _Volume) -> Value:
        """The surfaces that rays meet in a cell, and the volume in front of each; where the last one is."""
        code, course, way, line = self._code, noted.course, noted.way, (noted.way.spot, slabs.slab)
        before = [code.select(found, count, 0) for count in crossed(code, course)]
        second, third = before[0], before[0] + before[1]
        total, nth, last = third + before[2], Variable(code.number(I32, 0)), Variable(slabs.begin(slabs.count))
        rounds = code.largest(total)
        with code.loop(lambda: nth.now < rounds):
            number = code.splat(nth.now)
            low, high, past = course[0], course[1], code.same(I32, 0)
            for n, begin in ((1, second), (2, third)):
                behind = number >= begin
                low, high = (_chosen(code, behind, *pair) for pair in ((course[n], low), (course[n + 1], high)))
                past = code.select(behind, begin, past)
            here = found & (number < total)
            surface = _surface(code, low, high, number - past)
            value, _, _, _, r, g, b, opacity = rows(code, self._rows, code.select(here, surface, 0), ROW_FLOATS)
            place = root(code, lambda along: self._courses.at(way, slabs.slab, along), value, (low, high), here)
            # Those in front of these slabs, and behind them, are other slabs'.
            met = here & (place >= slabs.begin(code.same(I32, 0))) & (place < slabs.begin(slabs.count))
            last.set(code.select(met, place, last.now))
            volume.take_to(place, met)
            front = sums[3].now
            self._take_surface(sums, line, place, met, (r, g, b), opacity)
            volume.note(sums[3].now > front, slabs.number(place))
            nth.set(nth.now + 1)
        return last.now

    def _take_surface(
        self, sums: Variables, line: tuple[Spot, Vector], along: Value, met: Value, colour: Vector, opacity: Value
    ) -> None:
        code, at = self._code, self._samples.moved(*line, along)
        x, y, z = (cell.to(F64) + beyond.to(F64) for cell, beyond in zip(at.cell, at.beyond, strict=True))
        seen = met & keeps(code, self._job, (x, y, z))
        with code.when(code.any(seen)):
            lit = self._relief.lit(colour, self._relief.gradient(at), at, line[1], capped=False)
            take_sample(code, sums, seen, opacity, lit)


class _Volume:
    """The volume in which surfaces stand, slab after slab; without one nothing is taken.

    Parameters
    ----------
    optics : of the volume; None: there is none
    whole : slabs are no shares of slabs
    """

    def __init__(
        self,
        code: Code,
        slabs: _Slabs,
        sums: Variables,
        samples: Samples,
        cut: Cut,
        optics: Optics | None,
        whole: bool,
    ) -> None:
        self._code, self._slabs, self._sums, self._samples, self._cut = code, slabs, sums, samples, cut
        self._optics, self._whole = optics, whole
        # The slab that comes next, and from where on it is left.
        self._at, self._from = Variable(code.same(I32, 0)), Variable(slabs.begin(code.same(I32, 0)))

    def take_to(self, place: Value, drawn: Value) -> None:
        """Take what is left of slabs up to a place."""
        if self._optics is None:
            return
        code, slabs = self._code, self._slabs

        def left() -> Value:
            return drawn & (self._from.now < place) & (self._at.now < slabs.count)

        with code.loop(lambda: code.any(left())):
            taken, at, begin = left(), self._at.now, self._from.now
            ends = slabs.begin(at + 1)
            until = code.least(place, ends)
            middle = self._samples.moved(*slabs.line, slabs.middle(at))
            full = until.equals(ends) & begin.equals(slabs.begin(at))
            self._take(middle, until - begin, taken & self._cut.keeps(at), full)
            self._from.set(code.select(taken, until, begin))
            self._at.set(code.select(taken & until.equals(ends), at + 1, at))

    def note(self, found: Value, number: Value) -> None:
        """Tell the next frame in which slab of a run something has been found."""
        if self._whole:
            self._samples.note(found, number)

    def _take(self, middle: Spot, length: Value, taken: Value, full: Value) -> None:
        """So much of slabs, as their midpoints are; `full`: all of them."""
        code, optics, slab, front = self._code, self._optics, self._slabs.slab, self._sums[3].now
        assert optics is not None, "there is a volume"
        s = self._samples.at(middle)
        share = taken & (s >= optics.visible_from)
        if self._whole:
            seen, share = share & full, share & ~full
            with code.when(code.any(seen)):
                found = optics.of_slab(s, middle, slab)
                take_sample(code, self._sums, seen, found.opacity, found.colour)
        with code.when(code.any(share)):
            found = optics.of_share(s, length, middle, slab)
            take_sample(code, self._sums, share, found.opacity, found.colour)
        self.note(self._sums[3].now > front, self._at.now)


def _chosen(code: Code, where: Value, a: Mark, b: Mark) -> Mark:
    return Mark(*(code.select(where, *pair) for pair in zip(a.parts, b.parts, strict=True)))


def _surface(code: Code, low: Mark, high: Mark, nth: Value) -> Value:
    """Which surface is the n-th that is met between two places."""
    return code.select(high.reached > low.reached, low.reached + nth, low.reached - 1 - nth)
