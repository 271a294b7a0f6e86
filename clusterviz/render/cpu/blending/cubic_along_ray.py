"""The field along rays in a cell, as far as isosurfaces need it.

There it is a polynomial of third degree; of splines it is one of ninth, and nearly one of third. Between turns it is
monotone and meets each surface once at most. Surfaces stand in the order of their values, so how many of them a scalar
reaches says between which it lies.

References
----------
G. Marmitt, A. Kleer, I. Wald, H. Friedrich, P. Slusallek: Fast and accurate ray-voxel intersection techniques for
iso-surface ray tracing, VMV 2004, section 3 (the extrema of the cubic isolate its roots).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, I64, Value, Vector
from clusterviz.render.cpu.blending.samples import Samples
from clusterviz.render.cpu.fields.field import Cubic, Spot
from clusterviz.render.cpu.job import Job

ROW_FLOATS = 8  # value, 0, 0, 0; colour, opacity: a surface's two rows of plan/blend_mode.py
CUTS = 4  # where a cell begins, two turns, where it ends
SMALLEST = 1e-30
FAR = 3.4e38  # beyond what is a number


@dataclass(frozen=True)
class Level:
    """Where a scalar lies among the surfaces.

    Attributes
    ----------
    low, high : the values between which it is, the first of which it may be
    reached : surfaces whose value is not above it
    """

    low: Value
    high: Value
    reached: Value


@dataclass(frozen=True)
class Mark:
    """A place along rays.

    Attributes
    ----------
    along : slabs from the spot
    s : the scalar there
    reached : surfaces whose value is not above it
    """

    along: Value
    s: Value
    reached: Value

    @property
    def parts(self) -> tuple[Value, ...]:
        """All of it."""
        return self.along, self.s, self.reached


CubicAlongRay = Sequence[Mark]
"""Where rays enter a cell, where they turn in it, from front to back, and where they leave it."""


@dataclass(frozen=True)
class Way:
    """The field along rays through cells.

    Attributes
    ----------
    spot : in the cells
    enters, leaves : slabs from the spot
    cubic : from 0 to 1
    """

    spot: Spot
    enters: Value
    leaves: Value
    cubic: Cubic


class Courses:
    """The courses of rays as a kernel finds them.

    Parameters
    ----------
    sampled : polynomials are nearly the field, which has to be sampled
    """

    def __init__(self, code: Code, job: Job, samples: Samples, sampled: bool) -> None:
        self._code, self._samples, self._is_sampled = code, samples, sampled
        self._rows, self._count = job["surface"], job["surfaces"]

    def level(self, s: Value) -> Level:
        """Between which surfaces a scalar lies."""
        code, number = self._code, Variable(self._code.number(I32, 0))
        reached, low, high = (Variable(code.same(*one)) for one in ((I32, 0), (F32, -FAR), (F32, FAR)))
        with code.loop(lambda: number.now < self._count):
            value = code.splat(code.load(F32, self._rows + number.now.to(I64) * (4 * ROW_FLOATS)))
            is_met = s >= value
            reached.set(code.select(is_met, reached.now + 1, reached.now))
            low.set(code.select(is_met, value, low.now))
            high.set(code.select(is_met, high.now, code.least(high.now, value)))
            number.set(number.now + 1)
        return Level(low.now, high.now, reached.now)

    def of(self, way: Way, slab: Vector, before: Value) -> CubicAlongRay:
        """Of rays through cells.

        Parameters
        ----------
        before : how many surfaces the field reached behind the cell before, which is what it does where this one
            begins; below 0 where that is not known
        """
        code, (start, slope, bend, twist), length = self._code, way.cubic, way.leaves - way.enters
        marks = [Mark(way.enters, start, code.select(before >= 0, before, self.level(start).reached))]
        last = start + slope + bend + twist
        turns = self._turns(slope, bend, 3.0 * twist)
        places = [code.select(turn < 1.0, code.fma(length, turn, way.enters), way.leaves) for turn in turns]
        for along, s in zip((*places, way.leaves), (*self._at_turns(way, slab, places), last), strict=True):
            marks.append(Mark(along, s, self.level(s).reached))
        return marks

    def at(self, way: Way, slab: Vector, along: Value) -> Value:
        """The field somewhere on ways through cells."""
        if self._is_sampled:
            return self._samples.at(self._samples.moved(way.spot, slab, along))
        code, (a, b, c, d), length = self._code, way.cubic, way.leaves - way.enters
        t = (along - way.enters) / code.select(length > 0.0, length, 1.0)
        return code.fma(code.fma(code.fma(d, t, c), t, b), t, a)

    def _at_turns(self, way: Way, slab: Vector, places: list[Value]) -> list[Value]:
        """The field at both turns, in a loop, since a sample may be much code."""
        code, number, found = self._code, Variable(self._code.number(I32, 0)), [Variable(places[0]) for _ in places]
        with code.loop(lambda: number.now < len(found)):
            is_first = code.splat(number.now).equals(0)
            s = self.at(way, slab, code.select(is_first, *places))
            for place, where in zip(found, (is_first, ~is_first), strict=True):
                place.set(code.select(where, s, place.now))
            number.set(number.now + 1)
        return [place.now for place in found]

    def _turns(self, slope: Value, bend: Value, twist: Value) -> tuple[Value, Value]:
        """Where slope + 2 · bend · t + twist · t² is 0, in order, from 0 to 1; 1 where it is not."""
        code = self._code
        size = code.most(code.most(code.size(slope), code.size(bend)), code.most(code.size(twist), SMALLEST))
        slope, bend, twist = (part / size for part in (slope, bend, twist))
        square = bend * bend - slope * twist
        root = code.call("sqrt", code.most(square, 0.0))
        root = code.select(bend < 0.0, root - bend, -(bend + root))
        found = []
        for above, below in ((root, twist), (slope, root)):
            known = (square > 0.0) & (code.size(below) > SMALLEST)
            turn = above / code.select(known, below, 1.0)
            found.append(code.select(known & (turn > 0.0) & (turn < 1.0), turn, 1.0))
        return code.least(*found), code.most(*found)


class Noted:
    """Ways through cells, and the courses of rays on them, that loops change."""

    def __init__(self, code: Code, spot: Spot) -> None:
        self._code, self._spot = code, spot
        real, whole = code.same(F32, 0.0), code.same(I32, 0)
        self._cell, self._cubic = [Variable(at) for at in spot.low], [Variable(real) for _ in range(CUTS)]
        self._marks = [[Variable(part) for part in (real, real, whole)] for _ in range(CUTS)]

    @property
    def way(self) -> Way:
        """Through the cells."""
        x, y, z = (at.now for at in self._cell)
        a, b, c, d = (part.now for part in self._cubic)
        marks = self.course
        return Way(replace(self._spot, low=(x, y, z), high=(x, y, z)), marks[0].along, marks[-1].along, (a, b, c, d))

    @property
    def course(self) -> CubicAlongRay:
        """On it."""
        return [Mark(*(part.now for part in mark)) for mark in self._marks]

    def note(self, way: Way, course: CubicAlongRay, where: Value) -> None:
        """Change those of some rays."""
        parts = [*zip(self._cell, way.spot.low, strict=True), *zip(self._cubic, way.cubic, strict=True)]
        for places, mark in zip(self._marks, course, strict=True):
            parts += zip(places, mark.parts, strict=True)
        for place, part in parts:
            place.set(self._code.select(where, part, place.now))


def crossed(code: Code, course: CubicAlongRay) -> list[Value]:
    """How many surfaces are met before each turn, and behind the last, int32."""
    found = []
    for a, b in pairwise(course):
        found.append(code.select(a.reached < b.reached, b.reached - a.reached, a.reached - b.reached))
    return found
