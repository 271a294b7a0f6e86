"""Emission and absorption, front to back: the twin of samples.glsl, composite.glsl and over.glsl."""

from __future__ import annotations

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.vectors.classify import Class, Classifier
from clusterviz.render.vectors.field import Field, Spot
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.march import Four, Variables

AHEAD = 2.0  # slabs; what is asked for now should be there by then


class Composite:
    """Samples at midpoints, classified one by one; a `Look`."""

    def __init__(self, code: Code, job: Job, field: Field, classifier: Classifier) -> None:
        self._code, self._field, self._classifier = code, field, classifier
        self._stops = job.part("optics", 1) > 0.0
        self._far = job["far"].equals(1)
        self._residual = code.splat(job.part("optics", 1))

    def run(self, kept: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> tuple[Four, Value]:
        """The sum of the run's samples."""
        code, end, rest = self._code, Variable(slabs), 1.0 - kept[3].now
        sum_ = [Variable(code.same(F32, 0.0)) for _ in range(4)]
        number, most = Variable(code.number(I32, 0)), Variable(code.largest(slabs))
        with code.loop(lambda: number.now < most.now):
            along = code.splat(number.now.to(F32))
            s = self._field.at(self._moved(spot, slab, along))
            with code.when(self._far):
                self._field.ask_for(self._moved(spot, slab, along + AHEAD))
            # NaN compares false.
            seen = (s >= self._classifier.visible_from) & (number.now < end.now)
            with code.when(code.any(seen)):
                self._take(sum_, seen, self._classifier.of_slab(s))
                with code.when(self._stops):
                    # A ray ends with the sample that leaves too little light, not with its run.
                    ended = seen & (rest * (1.0 - sum_[3].now) <= self._residual)
                    end.set(code.select(ended, number.now + 1, end.now))
                    most.set(code.largest(end.now))
            number.set(number.now + 1)
        r, g, b, a = (part.now for part in sum_)
        return (r, g, b, a), end.now

    def _moved(self, spot: Spot, slab: Vector, along: Value) -> Spot:
        """A spot so many slabs on."""
        x, y, z = (self._code.fma(along, by, at) for by, at in zip(slab, spot.beyond, strict=True))
        return Spot(spot.voxel, spot.low, spot.high, (x, y, z))

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab, sampled at its midpoint."""
        s = self._field.at(spot)
        sum_ = [Variable(self._code.same(F32, 0.0)) for _ in range(4)]
        self._take(sum_, drawn & (s >= self._classifier.visible_from), self._classifier.of_share(s, share))
        r, g, b, a = (part.now for part in sum_)
        return r, g, b, a

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Behind what is there, with compensation (Kahan), so that 10⁶ faint slabs add up."""
        rest = 1.0 - kept[3].now
        for place, lost, more in zip(kept[:4], kept[4:], run, strict=True):
            term = rest * more - lost.now
            total = place.now + term
            # A ray that has no part in a run keeps its last bit, whichever other rays its packet has.
            lost.set(self._code.select(drawn, (total - place.now) - term, lost.now))
            place.set(self._code.select(drawn, total, place.now))

    def is_done(self, kept: Variables) -> Value:
        """Where so little light is left that the scene allows to stop."""
        return 1.0 - kept[3].now <= self._residual

    def _take(self, sum_: Variables, seen: Value, slab: Class) -> None:
        code = self._code
        weight = code.select(seen, (1.0 - sum_[3].now) * slab.opacity, 0.0)
        for part, colour in zip(sum_, slab.colour, strict=False):
            part.set(code.select(seen, code.fma(weight, colour, part.now), part.now))
        sum_[3].set(sum_[3].now + weight)
