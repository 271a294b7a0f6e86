"""What the transfer function gives samples: the twin of transfer.glsl and segment.glsl."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.plan.segments import FAR, Segments
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.transfer.opacity import slab_opacity
from clusterviz.render.cpu.transfer.tables import rows

BELOW_ONE = 1.0 - 2.0**-24


@dataclass(frozen=True)
class Class:
    """What samples come to.

    Attributes
    ----------
    opacity : of a slab
    colour : straight
    """

    opacity: Value
    colour: Vector


class Classifier:
    """The transfer function as a kernel reads it."""

    def __init__(self, code: Code, job: Job) -> None:
        self._code = code
        self._further, self._record_floats = job["further_starts"], job["record_floats"]
        self._buckets, self._colours, self._records = (job[f"{name}_rows"] for name in ("bucket", "colour", "record"))
        self._low, self._per_unit, self._last, self.visible_from = (
            code.splat(job.part("buckets", k)) for k in range(4)
        )
        self._last_segment, self._units = code.splat(job["last_segment"]), code.splat(job["optics"])

    def segment_of(self, s: Value) -> tuple[Value, Value]:
        """The segment of each scalar, int32, the last one that starts at or below it; and where it starts."""
        code = self._code
        bucket = code.within((s - self._low) * self._per_unit, 0.0, self._last)
        next_start, start, first, _ = rows(code, self._buckets, bucket.to(I32), 4)
        beyond = s >= next_start
        segment = Variable(first.bits(I32) + beyond.to(I32))
        begin = Variable(code.select(beyond, next_start, start))
        stride = Variable(self._further)
        with code.loop(lambda: stride.now > 0):
            later = code.least(segment.now + stride.now, self._last_segment)
            later_start = code.gather(F32, self._records, later * self._record_floats, 4)
            reached = s >= later_start
            segment.set(code.select(reached, later, segment.now))
            begin.set(code.select(reached, later_start, begin.now))
            stride.set(stride.now >> 1)
        return segment.now, begin.now

    def of_slab(self, s: Value) -> Class:
        """Of whole slabs."""
        code = self._code
        segment, start = self.segment_of(s)
        opacity, slope, *colours = rows(code, self._colours, segment, 8)
        beyond = s - start
        r, g, b = (code.fma(by, beyond, at) for at, by in zip(colours[:3], colours[3:], strict=True))
        return Class(code.within(code.fma(slope, beyond, opacity), 0.0, 1.0), (r, g, b))

    def unit_opacity(self, s: Value) -> Value:
        """Over one opacity unit distance."""
        segment, _ = self.segment_of(s)
        a = rows(self._code, self._records, segment, 12)
        return self._code.within(self._code.fma(a[10], s - a[0], a[9]), 0.0, BELOW_ONE)

    def of_share(self, s: Value, share: Value) -> Class:
        """Of a share of a slab."""
        code = self._code
        segment, _ = self.segment_of(s)
        a = rows(code, self._records, segment, 12)
        beyond = s - a[0]
        unit = code.within(code.fma(a[10], beyond, a[9]), 0.0, BELOW_ONE)
        r, g, b = (code.fma(a[6 + k], beyond, a[3 + k]) for k in range(3))
        return Class(slab_opacity(code, unit, share * self._units), (r, g, b))


def bucket_rows(segments: Segments) -> NDArray[np.float32]:
    """The buckets of a plan as rows: where the next segment starts, where the first one does, its number."""
    table = np.zeros((len(segments.buckets), 4), np.float32)
    first = segments.buckets["first"]
    table[:, 0] = segments.buckets["next_start"]
    table[:, 1] = np.append(segments.records["start"], FAR)[first]
    table[:, 2] = first.astype(np.int32).view(np.float32)
    return table


def colour_rows(segments: Segments) -> NDArray[np.float32]:
    """What a whole slab needs of the records."""
    records = segments.records
    table = np.empty((len(records), 8), np.float32)
    table[:, 0], table[:, 1] = records["slab_opacity"], records["slab_slope"]
    table[:, 2:5], table[:, 5:] = records["colour"], records["colour_slope"]
    return table
