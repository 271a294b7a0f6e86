"""The way of rays from cell to cell up to those in which they meet isosurfaces, most of which need no closer look.

References
----------
M. Dowell, P. Jarratt: A modified regula falsi method for computing the root of an equation, BIT 11, 1971 (the Illinois
method).
"""

from __future__ import annotations

from collections.abc import Callable

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.blending.cells import FAR, Cells, Courses, Level, Mark, Noted, Way, crossed
from clusterviz.render.cpu.blending.samples import Samples
from clusterviz.render.cpu.fields.field import Spot

REFINEMENTS = 10  # as in root.glsl
NEAR = 2.0**-20  # slabs; two guesses that are no farther apart end the search


def root(code: Code, field: Callable[[Value], Value], value: Value, sides: tuple[Mark, Mark], wanted: Value) -> Value:
    """Where on ways through cells the field is a value.

    That is where it begins, if it is on the same side there as behind: then it has jumped from the cell before. A ray
    that has its root keeps it while others of its packet look on.

    Parameters
    ----------
    field : somewhere on them
    sides : two places
    wanted : which rays look for a root
    """
    low, high = sides
    (a, above_a), (b, above_b) = ((Variable(side.along), Variable(side.s - value)) for side in sides)
    jumps = ~((low.s < value) ^ (high.s < value))
    c, last = Variable(code.select(jumps, low.along, high.along)), Variable(code.same(I32, 0))
    looking, number = Variable((wanted & ~jumps).to(I32)), Variable(code.number(I32, 0))
    with code.loop(lambda: code.any(looking.now > 0) & (number.now < REFINEMENTS)):
        goes_on = looking.now > 0
        guess = _between(code, (a.now, above_a.now), (b.now, above_b.now))
        above = field(guess) - value
        far = code.size(guess - c.now) > NEAR
        c.set(code.select(goes_on, guess, c.now))
        # The end on the guess's side moves; the other one counts half where it has stayed twice.
        behind = ~((above < 0.0) ^ (above_b.now < 0.0))
        side = code.select(behind, code.same(I32, 1), -1)
        share = code.select(last.now.equals(side), code.same(above.element, 0.5), 1.0)
        moves_b, moves_a = goes_on & behind, goes_on & ~behind
        above_a.set(code.select(moves_a, above, code.select(moves_b, above_a.now * share, above_a.now)))
        above_b.set(code.select(moves_b, above, code.select(moves_a, above_b.now * share, above_b.now)))
        a.set(code.select(moves_a, guess, a.now))
        b.set(code.select(moves_b, guess, b.now))
        last.set(side)
        looking.set((goes_on & far & ~above.equals(0.0)).to(I32))
        number.set(number.now + 1)
    return c.now


def _between(code: Code, first: tuple[Value, Value], second: tuple[Value, Value]) -> Value:
    """Where a straight line between two sides is 0."""
    (a, above_a), (b, above_b) = first, second
    rise = above_b - above_a
    flat = rise.equals(0.0)
    return code.select(flat, b, (a * above_b - b * above_a) / code.select(flat, 1.0, rise))


UNKNOWN = -1


class Search:
    """The way of rays to cells in which they meet surfaces.

    Attributes
    ----------
    noted : the last ones that were found
    """

    def __init__(self, code: Code, courses: Courses, cells: Cells) -> None:
        self._code, self._courses, self._cells = code, courses, cells
        self.noted = Noted(code, cells.here)
        # Between which surfaces the field is where rays enter their cells; below 0: there is no field in front.
        self._low, self._high = Variable(code.same(F32, FAR)), Variable(code.same(F32, -FAR))
        self._reached = Variable(code.same(I32, UNKNOWN))

    def go_on(self, samples: Samples, line: tuple[Spot, Vector], leaves: Value, wanted: Value) -> Value:
        """Go on to the next cells in which surfaces are met, and behind these; which rays meet one.

        Parameters
        ----------
        line : spots, and slabs in voxels
        leaves : up to where rays are wanted, in slabs from the spots
        """
        code, cells = self._code, self._cells
        found = Variable(code.same(I32, 0))

        def looking() -> Value:
            return wanted & found.now.equals(0) & (cells.enters < leaves)

        with code.loop(lambda: code.any(looking())):
            going = looking()
            samples.ask_ahead(*line, cells.enters)
            past, faces = cells.leave()
            low, high, known = cells.extent()
            # Nothing compares with what is not known.
            differs = going & ~((low >= self._low.now) & (high < self._high.now) & known)
            with code.when(code.any(differs)):
                closer = Variable(self._take_level(low, high, known, differs).to(I32))
                with code.when(code.any(closer.now > 0)):
                    self._look_closer(line[1], past, closer.now > 0, found)
            cells.go_on(past, faces, going)
        return found.now > 0

    def _take_level(self, low: Value, high: Value, known: Value, there: Value) -> Value:
        """Take the level of cells that hold one, where none is known of those before; which others may hold more."""
        code, level, unknown = self._code, self._courses.level(low), self._reached.now < 0
        holds_one = there & known & unknown & (high < level.high)
        self._set(level, holds_one)
        self._reached.set(code.select(there & ~known, UNKNOWN, self._reached.now))
        self._low.set(code.select(there & ~known, FAR, self._low.now))
        return there & known & ~holds_one

    def _look_closer(self, slab: Vector, leaves: Value, there: Value, found: Variable) -> None:
        """Note the courses of rays through cells that may hold surfaces, or other levels than those before."""
        code, cells = self._code, self._cells
        way = Way(cells.here, cells.enters, leaves, cells.cubic(slab, leaves))
        course = self._courses.of(way, slab, self._reached.now)
        met, more, most = crossed(code, course)
        met = there & (met + more + most > 0)
        self.noted.note(way, course, met)
        found.set(code.select(met, 1, found.now))
        self._set(self._courses.level(course[-1].s), there)

    def _set(self, level: Level, there: Value) -> None:
        parts = ((self._low, level.low), (self._high, level.high), (self._reached, level.reached))
        for place, one in parts:
            place.set(self._code.select(there, one, place.now))
