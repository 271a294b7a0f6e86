"""Looks in which no light is blended, the twins of extreme.glsl and sum.glsl; pixels are as in image/merge.py.

How parts merge is said in image/merge.py: pixels are the stretch's largest scalar, the largest of all, what is known of
the stretch, and 1 where there is any sample.
"""

from __future__ import annotations

from clusterviz.image.merge import CLOSED, EXISTS, STARTS
from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.blending.samples import ABREAST, Samples, add_exactly, four, zeros
from clusterviz.render.cpu.fields.field import LARGEST, Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.march import Four, Variables
from clusterviz.render.cpu.transfer.classify import Classifier


class Extreme:
    """The largest or the smallest scalar of a ray; a `BlendMode`."""

    def __init__(self, code: Code, samples: Samples, largest: bool) -> None:
        self._code, self._samples, self._largest = code, samples, largest

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """The extreme of the run's samples, and whether there is any."""
        with self._samples.along(spot, slab, Variable(self._code.largest(slabs)), ABREAST) as samples:
            for s, number, _ in samples:
                self._take(sums, s, (number < slabs) & (self._code.size(s) <= LARGEST))
        return slabs

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab counts as a whole one."""
        found, s = zeros(self._code), self._samples.at(spot)
        self._take(found, s, drawn & (self._code.size(s) <= LARGEST))
        return four(found)

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """The extreme of both."""
        self._take(kept, run[0], drawn & (run[3] > 0.0))

    def is_done(self, kept: Variables) -> Value:
        """Nowhere."""
        return nowhere(self._code)

    def _take(self, found: Variables, s: Value, valid: Value) -> None:
        code, scalar, exists = self._code, found[0], found[3]
        further = s > scalar.now if self._largest else s < scalar.now
        better = valid & (further | exists.now.equals(0.0))
        scalar.set(code.select(better, s, scalar.now))
        exists.set(code.select(valid, 1.0, exists.now))


class FirstHit(Extreme):
    """The first scalar of a ray not below a threshold, the twin of first_hit.glsl; a `BlendMode`."""

    def __init__(self, code: Code, job: Job, samples: Samples) -> None:
        super().__init__(code, samples, True)
        self._threshold = code.splat(job.part("optics", 2))

    def is_done(self, kept: Variables) -> Value:
        """Where there is one."""
        return kept[3].now > 0.0

    def _take(self, found: Variables, s: Value, valid: Value) -> None:
        code, scalar, exists = self._code, found[0], found[3]
        hit = valid & (s >= self._threshold) & exists.now.equals(0.0)
        scalar.set(code.select(hit, s, scalar.now))
        exists.set(code.select(hit, 1.0, exists.now))


class Sum:
    """Averages and sums: opacity times scalar, cut to the range of clim, times slabs; and how many; a `BlendMode`."""

    def __init__(self, code: Code, samples: Samples, classifier: Classifier) -> None:
        self._code, self._samples, self._classifier = code, samples, classifier

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """Of whole slabs."""
        with self._samples.along(spot, slab, Variable(self._code.largest(slabs)), ABREAST) as samples:
            for s, number, _ in samples:
                self._take(sums, s, number < slabs, self._code.same(F32, 1.0))
        return slabs

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """Of a share."""
        sums = zeros(self._code)
        self._take(sums, self._samples.at(spot), drawn, share)
        return four(sums)

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """To what is there."""
        add_exactly(self._code, kept, run, drawn)

    def is_done(self, kept: Variables) -> Value:
        """Nowhere."""
        return nowhere(self._code)

    def _take(self, sums: Variables, s: Value, drawn: Value, share: Value) -> None:
        code = self._code
        valid = drawn & (code.size(s) <= LARGEST)
        more = share * self._classifier.unit_opacity(s) * code.within(s, 0.0, 1.0)
        sums[0].set(code.select(valid, sums[0].now + more, sums[0].now))
        sums[3].set(code.select(valid, sums[3].now + share, sums[3].now))


def nowhere(code: Code) -> Value:
    """A mask of no lane."""
    return code.same(I32, 0) > 0


class LocalMaximum:
    """The first stretch; a `BlendMode`."""

    def __init__(self, code: Code, job: Job, samples: Samples) -> None:
        self._code, self._samples = code, samples
        self._threshold = code.splat(job.part("optics", 2))

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """The stretch of the run's samples."""
        with self._samples.along(spot, slab, Variable(self._code.largest(slabs)), ABREAST) as samples:
            for s, number, _ in samples:
                self._take(sums, s, number < slabs)
        return slabs

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab counts as a whole one."""
        found = zeros(self._code)
        self._take(found, self._samples.at(spot), drawn)
        return four(found)

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """A later part of the ray."""
        self._merge(kept, run, drawn & (run[3] > 0.0))

    def is_done(self, kept: Variables) -> Value:
        """Where the stretch has ended."""
        return (kept[2].now.to(I32) & CLOSED) > 0

    def _take(self, found: Variables, s: Value, drawn: Value) -> None:
        code = self._code
        above = s >= self._threshold
        known = code.select(above, code.same(F32, float(STARTS | EXISTS)), 0.0)
        # NaN compares false.
        valid = drawn & (code.size(s) <= LARGEST)
        self._merge(found, (code.select(above, s, 0.0), s, known, code.same(F32, 1.0)), valid)

    def _merge(self, front: Variables, behind: Four, valid: Value) -> None:
        """Put what has samples behind what may have none."""
        code = self._code
        stretch, largest, known, exists = front[:4]
        ahead, after = known.now.to(I32), behind[2].to(I32)
        empty, no_stretch = exists.now.equals(0.0), (ahead & EXISTS).equals(0)
        goes_on = (ahead & CLOSED).equals(0) & ((after & STARTS) > 0)
        both = code.select(goes_on, code.most(stretch.now, behind[0]), stretch.now)
        ended = code.select(goes_on, ahead | (after & CLOSED), ahead | CLOSED)
        later = code.select(empty, after, after & ~code.same(I32, STARTS))
        flags = code.select(no_stretch, later, ended)
        stretch.set(code.select(valid, code.select(no_stretch, behind[0], both), stretch.now))
        most = code.select(empty, behind[1], code.most(largest.now, behind[1]))
        largest.set(code.select(valid, most, largest.now))
        known.set(code.select(valid, flags.to(F32), known.now))
        exists.set(code.select(valid, 1.0, exists.now))
