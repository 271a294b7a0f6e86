"""The cells that rays pass, one after another: where they enter and leave each, and between which scalars it lies.

Cells are those in which the field is one polynomial; of nearest voxels these are the voxels, half a cell before their
corners. A ray's way through a cell is found by one expression, wherever its run begins or ends.

There it is a polynomial of third degree; of splines it is one of ninth, and nearly one of third. Between turns it is
monotone and meets each surface once at most. Surfaces stand in the order of their values, so how many of them a scalar
reaches says between which it lies.

References
----------
J. Amanatides, A. Woo: A fast voxel traversal algorithm for ray tracing, Eurographics 1987, section 2.
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
from clusterviz.render.cpu.fields.field import Cubic, Field, Spot
from clusterviz.render.cpu.job import Job

ROW_FLOATS = 8  # value, 0, 0, 0; colour, opacity: a surface's two rows of plan/blend_mode.py
CUTS = 4  # where a cell begins, two turns, where it ends
SMALLEST = 1e-30
INFINITE = 3.4e38  # beyond what is a number


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
        reached, low, high = (Variable(code.same(*one)) for one in ((I32, 0), (F32, -INFINITE), (F32, INFINITE)))
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


FAR = 3e38
EARLIER = 1e-4  # slabs before a run; where it begins on a face, the cell before that face tells what is met at it
STILL = 1e-30  # voxels a slab; rays that are slower along an axis do not move


class Cells:
    """The way of rays through cells.

    Parameters
    ----------
    line : spots, and slabs in voxels
    begin : how many slabs on from the spots
    """

    def __init__(self, code: Code, job: Job, field: Field, line: tuple[Spot, Vector], begin: Value) -> None:
        self._code, self._field, (self._spot, slab) = code, field, line
        shift, self._faces, self._steps, cells = 0.5 * field.is_nearest, [], [], []
        enters = code.same(F32, -FAR)
        for by, at in zip(slab, self._spot.beyond, strict=True):
            moves, rises = code.size(by) > STILL, by > 0.0
            per_voxel = code.select(moves, 1.0 / code.select(moves, by, 1.0), 0.0)
            offset, up = (-shift - at) * per_voxel, code.select(rises, code.same(F32, 1.0), 0.0)
            cell = code.call("floor", code.fma(begin - EARLIER, by, at) + shift)
            met = code.fma(cell + (1.0 - up), per_voxel, offset)
            enters = code.most(code.select(moves, met, -FAR), enters)
            self._faces.append((up, per_voxel, code.select(moves, offset, FAR)))
            self._steps.append(2.0 * up - 1.0)
            cells.append(Variable(cell))
        self._cells, self._enters = cells, Variable(enters)
        self._low, self._high = self._in_volume(job)

    def _in_volume(self, job: Job) -> tuple[list[Value], list[Value]]:
        """How far cells may be moved that are of the brick and of the volume."""
        code, spot, low, high = self._code, self._spot, [], []
        for axis, cell in enumerate(spot.cell):
            last = job.part("cells", axis) - int(not self._field.is_nearest)
            low.append(code.most(spot.low[axis], (0 - cell).to(F32)))
            high.append(code.least(spot.high[axis], (last - cell).to(F32)))
        return low, high

    @property
    def enters(self) -> Value:
        """Where rays enter the cells that they are in, in slabs from the spots."""
        return self._enters.now

    @property
    def here(self) -> Spot:
        """The spots, as seen in these cells: rounding takes no place out of them."""
        x, y, z = self._whole()
        return replace(self._spot, low=(x, y, z), high=(x, y, z))

    def extent(self) -> tuple[Value, Value, Value]:
        """Between which scalars the field lies in these cells, and whether they have one."""
        return self._field.extent(self._field.first_corner(self._spot, self._whole()))

    def cubic(self, slab: Vector, leaves: Value) -> Cubic:
        """The field along the way through these cells, from 0 to 1; of splines, one that is nearly it."""
        code, cells = self._code, self._whole()
        length = leaves - self.enters
        spot = zip(slab, self._spot.beyond, cells, strict=True)
        at = [code.fma(self.enters, by, beyond - cell) for by, beyond, cell in spot]
        return self._field.cubic(self._field.first_corner(self._spot, cells), at, [length * by for by in slab])

    def _whole(self) -> list[Value]:
        parts = zip(self._cells, self._low, self._high, strict=True)
        return [self._code.within(cell.now, low, high) for cell, low, high in parts]

    def leave(self) -> tuple[Value, list[Value]]:
        """Where rays leave these cells, and where the faces before them lie along each axis."""
        code, found, faces = self._code, self._code.same(F32, FAR), []
        for cell, (up, per_voxel, offset) in zip(self._cells, self._faces, strict=True):
            faces.append(code.fma(cell.now + up, per_voxel, offset))
            found = code.least(faces[-1], found)
        return code.most(found, self.enters), faces

    def go_on(self, leaves: Value, faces: list[Value], going: Value) -> None:
        """Go to the next cells."""
        code = self._code
        for cell, face, step in zip(self._cells, faces, self._steps, strict=True):
            cell.set(code.select(going & (face <= leaves), cell.now + step, cell.now))
        self._enters.set(code.select(going, leaves, self._enters.now))
