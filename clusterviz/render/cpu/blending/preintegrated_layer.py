"""One of several volumes whose slabs are classified between their ends: the twin of absorbing_ramp.glsl.

What counts of a slab is the part that lies in the volume. Its optical depth is exact for a field that is linear between
the part's ends, its colour is the mean of what absorbs; in which order it does so within a slab is of no account.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.blending.multi_volume import Slabs
from clusterviz.render.cpu.blending.preintegrated import Preintegrated
from clusterviz.render.cpu.blending.samples import Samples
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.march import Variables
from clusterviz.render.cpu.marching.volume_bounds import Body, RankWork
from clusterviz.render.cpu.transfer.preintegrated_segments import Ramps


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
