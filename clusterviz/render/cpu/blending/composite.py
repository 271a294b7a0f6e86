"""Emission and absorption, front to back: the twin of composite.glsl."""

from __future__ import annotations

from functools import reduce
from operator import or_

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import Value, Vector
from clusterviz.render.cpu.blending.classified import Optics
from clusterviz.render.cpu.blending.samples import ABREAST, Samples, add_exactly, four, zeros
from clusterviz.render.cpu.fields.field import Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.adaptive_step import Stretch
from clusterviz.render.cpu.marching.march import Four, Variables
from clusterviz.render.cpu.transfer.classify import Class


def take_sample(code: Code, sums: Variables, seen: Value, opacity: Value, colour: Vector) -> None:
    """Put a sample behind those of its run, where it is seen; `colour` is straight."""
    weight = code.select(seen, (1.0 - sums[3].now) * opacity, 0.0)
    for part, channel in zip(sums, colour, strict=False):
        part.set(code.select(seen, code.fma(weight, channel, part.now), part.now))
    sums[3].set(sums[3].now + weight)


def put_behind(code: Code, kept: Variables, run: Four, drawn: Value) -> None:
    """Add a run behind what is kept, where it is drawn."""
    rest = 1.0 - kept[3].now
    r, g, b, a = (rest * part for part in run)
    add_exactly(code, kept, (r, g, b, a), drawn)


def too_little_left(kept: Variables, residual: Value) -> Value:
    """Where so little light is left that the scene allows to stop."""
    return 1.0 - kept[3].now <= residual


class Composite:
    """Samples at midpoints, classified one by one; a `BlendMode`.

    Parameters
    ----------
    stretch : where slabs may be longer; None: nowhere
    """

    def __init__(self, code: Code, job: Job, samples: Samples, optics: Optics, stretch: Stretch | None = None) -> None:
        self._code, self._samples, self._optics, self._stretch = code, samples, optics, stretch
        self._stops = job.part("optics", 1) > 0.0
        self._residual = code.splat(job.part("optics", 1))

    def run(self, kept: Variables, sums: Variables, spot: Spot, slab: Vector, slabs: Value, first: Value) -> Value:
        """The sum of the run's samples."""
        code, end, rest = self._code, Variable(slabs), 1.0 - kept[3].now
        most, before = Variable(code.largest(slabs)), sums[3].now
        with self._samples.along(spot, slab, most, ABREAST) as samples:
            # NaN compares false.
            seen = [(s >= self._optics.visible_from) & (number < end.now) for s, number, _ in samples]
            with code.when(code.any(reduce(or_, seen))):
                found = [self._optics.of_slab(s, here, slab) for s, _, here in samples]
                for (_, number, _), here, one in zip(samples, seen, found, strict=True):
                    mine = here & (number < end.now)
                    self._take(sums, mine, self._stretch.of_stretches(one) if self._stretch else one)
                    self._samples.note(sums[3].now > before, number)
                    with code.when(self._stops):
                        # A ray ends with the sample that leaves too little light, not with its run.
                        ended = mine & (rest * (1.0 - sums[3].now) <= self._residual)
                        end.set(code.select(ended, number + 1, end.now))
                        with code.when(code.any(ended)):
                            most.set(code.largest(end.now))
        return end.now

    def last(self, spot: Spot, slab: Vector, share: Value, drawn: Value, only: Value) -> Four:
        """A share of a slab, sampled at its midpoint."""
        s, sums = self._samples.at(spot), zeros(self._code)
        seen = drawn & (s >= self._optics.visible_from)
        self._take(sums, seen, self._optics.of_share(s, share, spot, slab))
        return four(sums)

    def add(self, kept: Variables, run: Four, drawn: Value) -> None:
        """Behind what is there."""
        put_behind(self._code, kept, run, drawn)

    def is_done(self, kept: Variables) -> Value:
        """Where so little light is left that the scene allows to stop."""
        return too_little_left(kept, self._residual)

    def _take(self, sums: Variables, seen: Value, slab: Class) -> None:
        take_sample(self._code, sums, seen, slab.opacity, slab.colour)
