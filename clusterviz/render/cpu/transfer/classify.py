"""What the transfer function gives samples: the twin of transfer.glsl and segment.glsl.

A gathering load for each float would take several times as long.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import BYTES, F32, I32, I64, Operand, Value, Vector
from clusterviz.plan.segments import FAR, Segments
from clusterviz.render.cpu.job import Job

OPTICAL = (0.222222222, 0.285714286, 0.4, 0.666666667, 2.0)
EXPONENTIAL = (0.000198412698, 0.00138888889, 0.00833333333, 0.0416666667, 0.166666667, 0.5, 1.0)


def optical_depth(code: Code, a: Value) -> Value:
    """−log(1 − a) for a in [0, 1 − 2⁻²⁴]: the exponent apart, and atanh's series for the mantissa."""
    exponent, mantissa = _split(1.0 - a)
    exponent = code.select(a < 0.29, 0, exponent)
    # Where the exponent is 0 the mantissa less one is -a itself, with all of its digits.
    return -_logarithm(code, exponent, code.select(exponent.equals(0), -a, mantissa))


def power(code: Code, x: Value, y: Value) -> Value:
    """x^y to 2e-7 of 1, for x in [0, 1] and y ≥ 0; 0^0 is 1."""
    depth = -_logarithm(code, *_split(code.most(x, 1e-37)))
    found = 1.0 - absorbed(code, depth * y)
    return code.select((x > 0.0) | y.equals(0.0), found, 0.0)


def _split(x: Value) -> tuple[Value, Value]:
    """The exponent of normal numbers, and their mantissa less one: x = (1 + mantissa) · 2^exponent."""
    exponent = (x.bits(I32) - 0x3F3504F3).shifted(23)
    return exponent, (x.bits(I32) - (exponent << 23)).bits(F32) - 1.0


def _logarithm(code: Code, exponent: Value, mantissa: Value) -> Value:
    f = mantissa / (mantissa + 2.0)
    return code.fma(exponent.to(F32), 0.693147181, f * polynomial(code, f * f, OPTICAL))


def absorbed(code: Code, depth: Value) -> Value:
    """1 − exp(−depth) for depth ≥ 0: exp = 2⁻ⁿ (1 + q), so that nothing cancels for small depths (n = 0)."""
    d = code.least(depth, 80.0)
    n = code.call("floor", code.fma(d, 1.44269504, 0.5))
    r = code.fma(n, -2.12194440e-4, code.fma(n, 0.693359375, -d))
    q = r * polynomial(code, r, EXPONENTIAL)
    scale = ((127 - n.to(I32)) << 23).bits(F32)
    return (1.0 - scale) - scale * q


def slab_opacity(code: Code, a: Value, units: Operand) -> Value:
    """The opacity of a slab that is so many opacity unit distances long."""
    return absorbed(code, optical_depth(code, a) * units)


def polynomial(code: Code, x: Value, coefficients: tuple[float, ...]) -> Value:
    """By Horner's rule, the highest power first."""
    found = code.same(F32, coefficients[0])
    for coefficient in coefficients[1:]:
        found = code.fma(found, x, coefficient)
    return found


WIDTH = 4  # floats of a load


def rows(code: Code, address: Value, row: Value, floats: int, element: Any = F32) -> list[Value]:
    """The floats of a row of a table for each lane.

    Parameters
    ----------
    row : int32, which one
    floats : in a row; a multiple of four
    element : F32 or F64
    """
    numbers = row.to(I64) * (BYTES[element] * floats)
    places = [address + numbers.lane(lane) for lane in range(code.lanes)]
    columns: list[Value] = []
    for part in range(0, floats, WIDTH):
        quads = [code.load(element, place + BYTES[element] * part, WIDTH) for place in places]
        # Column j of a group holds rows j, j + 4, ... so that each quarter of the lanes is turned by itself.
        groups = [quads[start::WIDTH] for start in range(WIDTH)]
        columns += _turned(code, [_joined(code, group) for group in groups])
    return columns


def _joined(code: Code, parts: list[Value]) -> Value:
    while len(parts) > 1:
        parts = [code.join(a, b) for a, b in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


def _turned(code: Code, a: list[Value]) -> list[Value]:
    """Rows of four lanes each become columns: of every quarter, and for all of them at once."""
    n = a[0].lanes

    def mixed(first: Value, second: Value, pattern: tuple[int, int, int, int]) -> Value:
        # Numbers from 4 on are the second vector's.
        lanes = [quarter + (p if p < WIDTH else n + p - WIDTH) for quarter in range(0, n, WIDTH) for p in pattern]
        return code.shuffle(first, second, lanes)

    low, high = (0, 4, 1, 5), (2, 6, 3, 7)
    pairs = [mixed(a[0], a[1], low), mixed(a[2], a[3], low), mixed(a[0], a[1], high), mixed(a[2], a[3], high)]
    left, right = (0, 1, 4, 5), (2, 3, 6, 7)
    return [mixed(pairs[k], pairs[k + 1], side) for k in (0, 2) for side in (left, right)]


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
