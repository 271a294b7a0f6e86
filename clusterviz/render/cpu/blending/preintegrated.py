"""Pre-integrated classification: the twin of preintegrated.glsl.

The field is sampled where slabs meet, once for both. Most slabs have nothing visible at either end; their transfer
function is not looked up.

What counts of a slab is the part that lies in the volume. Its optical depth is exact for a field that is linear between
the part's ends, its colour is the mean of what absorbs; in which order it does so within a slab is of no account.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.blending.classified import GradientShading
from clusterviz.render.cpu.blending.composite import put_behind, too_little_left
from clusterviz.render.cpu.blending.multi_volume import Slabs
from clusterviz.render.cpu.blending.samples import Samples, four, zeros
from clusterviz.render.cpu.fields.field import LARGEST, Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.march import Four, Variables
from clusterviz.render.cpu.marching.volume_bounds import Body, RankWork
from clusterviz.render.cpu.transfer.preintegrated_segments import RECORD_FLOATS, End, Ramps

# Where a ray enters and leaves the volume: rounding must not put its ends behind the faces, into cells that are none.
WITHIN = 0.5 - 1e-6


class Preintegrated:
    """Slabs that are classified between their ends; a `BlendMode`.

    Parameters
    ----------
    relief : what depends on the gradient
    may_be_invalid : voxels may be NaN
    """

    def __init__(
        self, code: Code, job: Job, samples: Samples, ramps: Ramps, relief: GradientShading, may_be_invalid: bool
    ) -> None:
        self._relief = relief
        self._code, self._samples, self._ramps, self._may_be_invalid = code, samples, ramps, may_be_invalid
        self._stops = job.part("optics", 1) > 0.0
        self._units, self._residual = (code.splat(job.part("optics", k)) for k in range(2))

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """The sum of the run's slabs."""
        code, end, rest = self._code, Variable(slabs), 1.0 - kept[3].now
        most, before = Variable(code.largest(slabs)), sums[3].now
        begin = code.select(first, code.same(F32, -WITHIN), -0.5)
        front = _Front(code, self._ramps, self._samples.at(self._samples.moved(spot, slab, begin)))
        with self._samples.along(self._samples.later(spot, 0.5), slab, most) as ((s, number, _),):
            middle = self._samples.moved(spot, slab, code.splat(number.to(F32)))
            seen = self._take(sums, front, s, self._units, number < end.now, (middle, slab))
            self._samples.note(sums[3].now > before, number)
            with code.when(self._stops):
                # A ray ends with the slab that leaves too little light, not with its run.
                ended = seen & (rest * (1.0 - sums[3].now) <= self._residual)
                end.set(code.select(ended, number + 1, end.now))
                with code.when(code.any(ended)):
                    most.set(code.largest(end.now))
        return end.now

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab, around its midpoint."""
        code, sums = self._code, zeros(self._code)
        away = WITHIN * share
        ends = (self._samples.at(self._samples.moved(spot, slab, along)) for along in (-away, away))
        front = _Front(code, self._ramps, next(ends))
        self._take(sums, front, next(ends), self._units * share, drawn, (spot, slab))
        return four(sums)

    def parts(self, spot: Spot, slab: Vector, first: Value, begin: Value, leave: Value) -> tuple[Four, Value]:
        """The sum of parts of slabs from `begin` on, up to `leave`, and how many they are.

        Parameters
        ----------
        spot : of the places `first`, from which all others are counted
        first, begin, leave : float64, in slabs along the rays; parts are cut at whole numbers
        """
        code, sums, along = self._code, zeros(self._code), Variable(begin)
        front = _Front(code, self._ramps, self._samples.at(self._samples.moved(spot, slab, (begin - first).to(F32))))
        taken = Variable(code.same(I32, 0))
        with code.loop(lambda: code.any(along.now < leave)):
            seen, at = along.now < leave, along.now
            to = code.least(code.call("floor", at) + 1.0, leave)
            s = self._samples.on_the_way(spot, slab, (to - first).to(F32))
            middle = self._samples.moved(spot, slab, (0.5 * (at + to) - first).to(F32))
            self._take(sums, front, s, self._units * (to - at).to(F32), seen, (middle, slab))
            taken.set(taken.now + seen.to(I32))
            along.set(code.select(seen, to, at))
        return four(sums), taken.now

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Behind what is there."""
        put_behind(self._code, kept, run, drawn)

    def is_done(self, kept: Variables) -> Value:
        """Where so little light is left that the scene allows to stop."""
        return too_little_left(kept, self._residual)

    def _take(
        self, sums: Variables, front: _Front, s: Value, units: Value, drawn: Value, middle: tuple[Spot, Vector]
    ) -> Value:
        """Add slabs from the front to a back whose scalar is known, which then is the front; where they were seen."""
        code = self._code
        begin, end, some = Variable(front.s.now), Variable(s), Variable(drawn.to(I32))
        replaced = Variable(code.number(I32, 0))
        if self._may_be_invalid:
            self._without_invalid(begin, end, some, replaced, middle[0])
        seen = (some.now > 0) & (code.most(begin.now, end.now) >= self._ramps.visible_from)
        known = Variable(code.number(I32, 0))
        with code.when(code.any(seen)):
            with code.when((front.known.now.equals(0)) | (replaced.now > 0)):
                front.keep(self._ramps.end_at(begin.now))
            back = self._ramps.end_at(end.now)
            slab = self._integrated(front.end, back, units, seen, *middle)
            rest = code.select(seen, 1.0 - sums[3].now, 0.0)
            for place, part in zip(sums, slab, strict=True):
                place.set(code.select(seen, code.fma(rest, part, place.now), place.now))
            front.keep(back)
            known.set(1 - replaced.now)
        front.s.set(s)
        front.known.set(known.now)
        return seen

    def add_ramp(
        self, sums: Variables, ends: tuple[Value, Value], units: Value, drawn: Value, middle: tuple[Spot, Vector]
    ) -> None:
        """Add what slabs come to between two scalars to sums, as if nothing were in front of them."""
        code = self._code
        begin, end = (Variable(s) for s in ends)
        some, replaced = Variable(drawn.to(I32)), Variable(code.number(I32, 0))
        if self._may_be_invalid:
            self._without_invalid(begin, end, some, replaced, middle[0])
        seen = (some.now > 0) & (code.most(begin.now, end.now) >= self._ramps.visible_from)
        with code.when(code.any(seen)):
            front, back = (self._ramps.end_at(s.now) for s in (begin, end))
            slab = self._integrated(front, back, units, seen, *middle)
            for place, part in zip(sums, slab, strict=True):
                place.set(code.select(seen, place.now + part, place.now))

    def _integrated(self, front: End, back: End, units: Value, seen: Value, middle: Spot, slab: Vector) -> Four:
        """Slabs between their ends, faded and lit by the gradient at their midpoint."""
        code, gradient = self._code, self._relief.gradient_if_valid(middle)
        r, g, b, a = self._ramps.integrated(front, back, self._relief.faded(units, gradient), seen)
        if gradient is None:
            return r, g, b, a
        safe = code.select(a > 0.0, a, 1.0)
        x, y, z = self._relief.lit((r / safe, g / safe, b / safe), gradient, middle, slab)
        return x * a, y * a, z * a, a

    def _without_invalid(
        self, begin: Variable, end: Variable, some: Variable, replaced: Variable, middle: Spot
    ) -> None:
        """An end next to an invalid voxel counts as the midpoint; if that is invalid, too, a slab is transparent."""
        code = self._code
        fine = [code.size(side.now) <= LARGEST for side in (begin, end)]
        missing = (some.now > 0) & ~(fine[0] & fine[1])
        with code.when(code.any(missing)):
            between = self._samples.at(middle)
            for side, valid in zip((begin, end), fine, strict=True):
                side.set(code.select(valid, side.now, between))
            known = ~missing | (code.size(between) <= LARGEST)
            some.set(code.select(known, some.now, 0))
            replaced.set(code.number(I32, 1))


class _Front:
    """The front of the slabs that come next.

    Attributes
    ----------
    s : the scalar there
    known : 1: `end` is what it comes to
    """

    def __init__(self, code: Code, ramps: Ramps, s: Value) -> None:
        self.s, self.known = Variable(s), Variable(code.number(I32, 0))
        self._of, self._segment = Variable(s), Variable(code.same(I32, 0))
        self._record = [Variable(code.same(F32, 0.0)) for _ in range(RECORD_FLOATS)]

    @property
    def end(self) -> End:
        """What was kept."""
        return End(self._of.now, self._segment.now, tuple(part.now for part in self._record))

    def keep(self, end: End) -> None:
        """Keep what the scalar comes to."""
        self._of.set(end.s)
        self._segment.set(end.segment)
        for place, part in zip(self._record, end.record, strict=True):
            place.set(part)


class SummedRamps(Ramps):
    """Integrals whose parts are added, with nothing in front of each other: depths, and colours times these."""

    def _absorb(self, sums: list[Variable], depth: Value, mean: Vector, change: Vector, drawn: Value) -> None:
        code, depth = self._code, self._code.select(drawn, depth, 0.0)
        for place, at in zip(sums, mean, strict=False):
            place.set(code.fma(depth, code.within(at, 0.0, 1.0), place.now))
        sums[3].set(sums[3].now + depth)


class Ramped:
    """A volume that is integrated between the ends of slabs; an `VolumeLayer`.

    Parameters
    ----------
    job : the volume's own
    body : where rays are in it
    ramps : what slabs come to, by `SummedRamps`
    """

    def __init__(self, code: Code, job: Job, body: Body, samples: Samples, ramps: Preintegrated) -> None:
        self._code, self._body, self._samples, self._ramps = code, body, samples, ramps
        self._units = code.splat(job["optics"])
        # The scalar at the end of the slab before, and where that is the front of the next one.
        self._end, self._known = Variable(code.same(F32, 0.0)), Variable(code.same(I32, 0))

    def begin(self) -> None:
        """Nothing is known of the front of a run."""
        self._known.set(self._code.same(I32, 0))

    def add(self, mixed: Sequence[Variables], share: RankWork, slabs: Slabs) -> None:
        """What the parts of slabs come to that lie in the volume; where slabs meet it is sampled once for both."""
        code, half = self._code, 0.5 * slabs.length
        for sums, number, wanted in zip(mixed, slabs.numbers, slabs.wanted, strict=True):
            part = self._body.part(number, half)
            mine, known = wanted & share.there & (part[0] < part[1]), self._known.now > 0
            self._known.set(code.same(I32, 0))
            with code.when(code.any(mine)):
                self._add_part(sums, share, number.to(F32), part, (mine, known & part[0].equals(-half)))
                self._known.set((mine & part[1].equals(half)).to(I32))

    def _add_part(
        self, sums: Variables, share: RankWork, along: Value, part: tuple[Value, Value], where: tuple[Value, Value]
    ) -> None:
        """Add parts of slabs whose midpoints lie so far along; where: they matter, and their front is known."""
        code, stride, (mine, known) = self._code, self._body.stride, where
        # Whole numbers are added first: what they come to does not depend on where the run begins.
        spot = replace(share.spot, begin=along if share.spot.begin is None else share.spot.begin + along)
        front = Variable(self._end.now)
        with code.when(code.any(mine & ~known)):
            s = self._samples.at(self._samples.moved(spot, stride, part[0]))
            front.set(code.select(known, front.now, s))
        end = self._samples.on_the_way(spot, stride, part[1])
        self._end.set(end)
        middle = self._samples.moved(spot, stride, 0.5 * (part[0] + part[1]))
        self._ramps.add_ramp(sums, (front.now, end), self._units * (part[1] - part[0]), mine, (middle, stride))
