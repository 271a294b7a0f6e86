"""The field along slabs, as far as isosurfaces need it: the twin of slab_at in surfaces.glsl and turn_of in root.glsl.

Surfaces stand in the order of their values, so how many of them a scalar reaches says between which it lies.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, I64, Value, Vector
from clusterviz.render.vectors.fields.field import Spot
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.looks.samples import LARGEST, Samples

ROW_FLOATS = 8  # value, 0, 0, 0; colour, opacity: a surface's two rows of plan/look.py


@dataclass(frozen=True)
class Mark:
    """A scalar.

    Attributes
    ----------
    s : itself
    reached : surfaces whose value is not above it
    """

    s: Value
    reached: Value


@dataclass(frozen=True)
class Course:
    """The field along slabs of rays, one each.

    Attributes
    ----------
    front, middle, back : where they begin, at their midpoints, and where they end
    turn : where they are cut in two, in slabs from their midpoints
    at_turn : the field there
    """

    front: Mark
    middle: Value
    back: Mark
    turn: Value
    at_turn: Mark

    @property
    def parts(self) -> tuple[Value, ...]:
        """All of it."""
        f, b, t = self.front, self.back, self.at_turn
        return f.s, f.reached, self.middle, b.s, b.reached, self.turn, t.s, t.reached


class Courses:
    """The courses of slabs as a kernel finds them."""

    def __init__(self, code: Code, job: Job, samples: Samples) -> None:
        self._code, self._samples = code, samples
        self._rows, self._count = job["surface"], job["surfaces"]

    def mark(self, s: Value) -> Mark:
        """Of a scalar."""
        code, reached, number = self._code, Variable(self._code.same(I32, 0)), Variable(self._code.number(I32, 0))
        with code.loop(lambda: number.now < self._count):
            value = code.splat(code.load(F32, self._rows + number.now.to(I64) * (4 * ROW_FLOATS)))
            reached.set(code.select(s >= value, reached.now + 1, reached.now))
            number.set(number.now + 1)
        return Mark(s, reached.now)

    def of(self, line: tuple[Spot, Vector], half: Value, front: Mark, behind: Value, wanted: Value) -> Course:
        """Of slabs around the spots of a line, `half` to either side, with a scalar in front and one behind.

        They are cut at the extremum of the parabola through begin, middle and end, so that one which a surface both
        enters and leaves is not missed; at their end where there is none between.
        """
        code, back, middle = self._code, self.mark(behind), self._samples.at(line[0])
        slope, bend = behind - front.s, front.s - 2.0 * middle + behind
        turns = wanted & (code.size(slope) < 2.0 * code.size(bend))
        turn, s, reached = Variable(half), Variable(behind), Variable(back.reached)
        with code.when(code.any(turns)):
            at = -0.5 * half * slope / code.select(turns, bend, 1.0)
            found = self.mark(self._samples.at(self._samples.moved(*line, code.select(turns, at, half))))
            turns = turns & (code.size(found.s) <= LARGEST)
            for place, value in ((turn, at), (s, found.s), (reached, found.reached)):
                place.set(code.select(turns, value, place.now))
        return Course(front, middle, back, turn.now, Mark(s.now, reached.now))

    def is_valid(self, course: Course) -> Value:
        """Whether slabs have a scalar at both ends."""
        code = self._code
        # NaN compares false.
        return (code.size(course.front.s) <= LARGEST) & (code.size(course.back.s) <= LARGEST)

    def crossed(self, course: Course) -> tuple[Value, Value]:
        """How many surfaces the two parts of slabs cross, int32; none of those without a scalar at an end."""
        ends, code = (course.front, course.at_turn, course.back), self._code
        valid = self.is_valid(course)
        first, second = (code.select(valid, _distance(code, *pair), 0) for pair in pairwise(ends))
        return first, second


class Noted:
    """Courses that loops change."""

    def __init__(self, code: Code, mark: Mark) -> None:
        self._code = code
        like = Course(mark, mark.s, mark, mark.s, mark)
        self._parts = [Variable(part) for part in like.parts]

    @property
    def now(self) -> Course:
        """As they are."""
        f, front, middle, b, back, turn, t, at_turn = (part.now for part in self._parts)
        return Course(Mark(f, front), middle, Mark(b, back), turn, Mark(t, at_turn))

    def note(self, course: Course, where: Value) -> None:
        """Change those of some rays."""
        for place, part in zip(self._parts, course.parts, strict=True):
            place.set(self._code.select(where, part, place.now))


def _distance(code: Code, a: Mark, b: Mark) -> Value:
    return code.select(a.reached < b.reached, b.reached - a.reached, a.reached - b.reached)
