"""The largest scalar of the first stretch of a ray that is not below a threshold: the twin of local_maximum.glsl.

How parts merge is said in image/merge.py: pixels are the stretch's largest scalar, the largest of all, what is known of
the stretch, and 1 where there is any sample.
"""

from __future__ import annotations

from clusterviz.image.merge import CLOSED, EXISTS, STARTS
from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.blending.samples import ABREAST, Samples, four, zeros
from clusterviz.render.cpu.fields.field import LARGEST, Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.march import Four, Variables


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
