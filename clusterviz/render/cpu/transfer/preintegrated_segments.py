"""What the transfer function gives slabs along which the scalar goes linearly: the integrals of preintegrated.glsl.

The parts of a record and the sums are those of plan/preintegration.py.
"""

from __future__ import annotations

from dataclasses import dataclass

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, F64, Value, Vector
from clusterviz.plan.preintegration import SUM_ROWS
from clusterviz.render.cpu.blending.samples import zeros
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.transfer.classify import Classifier, absorbed, polynomial, rows

RECORD_FLOATS = 12
LEANING = (8.26719577e-7, -3.30687831e-5, 0.00138888889, -0.0833333333)
STEEPEST, WIDEST, DEEPEST = 4.0, 1.5, 1e30
Four = tuple[Value, Value, Value, Value]


@dataclass(frozen=True)
class End:
    """One end of a slab.

    Attributes
    ----------
    s : the scalar
    segment : of the transfer function, int32
    record : its 12 floats
    """

    s: Value
    segment: Value
    record: tuple[Value, ...]

    @property
    def start(self) -> Value:
        """Where the segment starts."""
        return self.record[0]

    @property
    def end(self) -> Value:
        """Where it ends."""
        return self.record[1]


class Ramps:
    """The integrals of a transfer function."""

    def __init__(self, code: Code, job: Job) -> None:
        self._code, self._classifier = code, Classifier(code, job)
        self._records, self._sums = job["record_rows"], job["sums"]
        self.visible_from = self._classifier.visible_from

    def end_at(self, s: Value) -> End:
        """An end of slabs."""
        segment, _ = self._classifier.segment_of(s)
        return End(s, segment, tuple(rows(self._code, self._records, segment, RECORD_FLOATS)))

    def integrated(self, front: End, back: End, units: Value, drawn: Value) -> Four:
        """Premultiplied colour and opacity of slabs, as if nothing were in front of them.

        Parameters
        ----------
        units : their length in opacity unit distances
        drawn : which matter
        """
        code, same = self._code, front.segment.equals(back.segment)
        rises = back.s > front.s
        leaves = code.select(same, back.s, code.select(rises, front.end, front.start))
        per_scalar = units / code.size(back.s - front.s)
        length = code.select(same, units, per_scalar * code.size(leaves - front.s))
        sums = zeros(code)
        self._absorb_within(sums, front, (front.s, leaves), length, drawn)
        apart = drawn & ~same
        with code.when(code.any(apart)):
            low = code.least(front.segment, back.segment) + 1
            high = code.most(front.segment, back.segment)
            between = apart & (low < high)
            with code.when(code.any(between)):
                self._absorb_between(sums, (code.least(low, high), high), rises, per_scalar, between)
            enters = code.select(rises, back.start, back.end)
            self._absorb_within(sums, back, (enters, back.s), per_scalar * code.size(back.s - enters), apart)
        r, g, b, a = (part.now for part in sums)
        return r, g, b, a

    def _absorb_within(
        self, sums: list[Variable], of: End, reach: tuple[Value, Value], units: Value, drawn: Value
    ) -> None:
        """What lies between two scalars of one segment, so many units long."""
        code = self._code
        k0, k1, k2, *colours, per_scalar = of.record[2:]
        d = (reach[1] - reach[0]) * per_scalar
        x = code.select(per_scalar.equals(0.0), 0.0, (0.5 * (reach[0] + reach[1]) - of.start) * per_scalar)
        kappa = code.most(code.fma(k2 * d, d * (1 / 12), code.fma(x, code.fma(x, k2, k1), k0)), 0.0)
        # How much more absorbs behind than in front: it moves the mean colour.
        some = kappa > 0.0
        slope = code.fma(2.0 * x, k2, k1) * d
        tilt = code.select(some, code.within(slope / code.select(some, kappa, 1.0), -STEEPEST, STEEPEST), 0.0)
        shift, lean = tilt * (1 / 12), code.fma(tilt * tilt, -1 / 20, 1.0)
        mean, change = [], []
        for at_start, to_end in zip(colours[:3], colours[3:], strict=True):
            by = to_end * d
            mean.append(code.fma(by, shift, code.fma(to_end, x, at_start)))
            change.append(by * lean)
        self._absorb(sums, units * kappa, _vector(mean), _vector(change), drawn)

    def _absorb_between(
        self, sums: list[Variable], whole: tuple[Value, Value], rises: Value, per_scalar: Value, drawn: Value
    ) -> None:
        """The whole segments from one up to another; `per_scalar`: the length over how far the scalar goes."""
        code = self._code
        low, high = (rows(code, self._sums, segment, SUM_ROWS, F64) for segment in whole)
        passed = [b - a for a, b in zip(low[:4], high[:4], strict=True)]
        some = drawn & (passed[0] > 0.0)
        over = 1.0 / code.select(some, passed[0], 1.0)
        mean, change = [], []
        for k in range(1, 4):
            at = passed[k] * over
            moment = ((high[3 + k] - low[3 + k]) - low[0] * passed[k]) * over * over
            by = code.within((12.0 * moment - 6.0 * at).to(F32), -WIDEST, WIDEST)
            mean.append(at.to(F32))
            change.append(code.select(rises, by, -by))
        depth = code.least(passed[0] * per_scalar.to(F64), DEEPEST).to(F32)
        self._absorb(sums, depth, _vector(mean), _vector(change), some)

    def _absorb(self, sums: list[Variable], depth: Value, mean: Vector, change: Vector, drawn: Value) -> None:
        """Put a part behind the parts that are there."""
        code = self._code
        opacity = absorbed(code, depth)
        weight = code.select(drawn, (1.0 - sums[3].now) * opacity, 0.0)
        leaning = self._leaning(depth, opacity)
        for place, at, by in zip(sums, mean, change, strict=False):
            colour = code.within(code.fma(leaning, by, at), 0.0, 1.0)
            place.set(code.fma(weight, colour, place.now))
        sums[3].set(sums[3].now + weight)

    def _leaning(self, depth: Value, opacity: Value) -> Value:
        """The share of its change by which a colour that changes linearly with the depth is seen beside its mean."""
        code, thin = self._code, depth < 1.0
        near = depth * polynomial(code, depth * depth, LEANING)
        far = 1.0 / code.select(thin, 1.0, depth) - 1.0 / code.select(thin, 1.0, opacity) + 0.5
        return code.select(thin, near, far)


def _vector(parts: list[Value]) -> Vector:
    x, y, z = parts
    return x, y, z
