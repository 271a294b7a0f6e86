"""The way of rays from cell to cell up to those in which they meet isosurfaces, most of which need no closer look."""

from __future__ import annotations

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.blending.cells import Cells
from clusterviz.render.cpu.blending.cubic_along_ray import FAR, Courses, Level, Noted, Way, crossed
from clusterviz.render.cpu.blending.samples import Samples
from clusterviz.render.cpu.fields.field import Spot

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
