"""What the magnitude of the gradient does to opacity: the twins of magnitude.glsl, faded.glsl and composite_2d.glsl.

The rows of the block and the table are those of plan/grading.py.
"""

from __future__ import annotations

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import I32, I64, Value, Vector
from clusterviz.render.cpu.fields.gradient import ROW_BYTES, length, number_at, turned, vector_at
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.transfer.classify import BELOW_ONE, Class, Classifier, rows, slab_opacity

FIRST_ROW, PIECES_ROW = 3, 4


class Magnitudes:
    """Magnitudes of gradients in the world."""

    def __init__(self, code: Code, job: Job) -> None:
        self._code, self._columns = code, [vector_at(code, job["grading"], column) for column in range(FIRST_ROW)]

    def of(self, gradient: Vector) -> Value:
        """In units of clim over the smallest spacing."""
        return length(self._code, turned(self._code, self._columns, gradient))


class Fading:
    """Gradient opacity: what extinction is multiplied by, piecewise linear in the magnitude."""

    def __init__(self, code: Code, job: Job) -> None:
        self._code, self._rows, self._count = code, job["grading"], job["fading"]
        self._magnitudes = Magnitudes(code, job)

    def factor(self, gradient: Vector) -> Value:
        """0 … 1."""
        code, magnitude = self._code, self._magnitudes.of(gradient)
        found, number = Variable(number_at(code, self._rows, FIRST_ROW, 0)), Variable(code.number(I32, 0))
        with code.loop(lambda: number.now < self._count):
            row = self._rows + number.now.to(I64) * ROW_BYTES
            start, per_length, rise, end = (number_at(code, row, PIECES_ROW, part) for part in range(4))
            # A step has no length.
            share = code.select(magnitude >= end, 1.0, code.within((magnitude - start) * per_length, 0.0, 1.0))
            found.set(code.fma(rise, share, found.now))
            number.set(number.now + 1)
        return code.within(found.now, 0.0, 1.0)


class Table:
    """A transfer function of scalars and magnitudes, in place of opacity alone or of colour, too."""

    def __init__(self, code: Code, job: Job, classifier: Classifier, has_colour: bool) -> None:
        self._code, self._classifier, self._has_colour = code, classifier, has_colour
        self._magnitudes, self._units = Magnitudes(code, job), code.splat(job["optics"])
        self._axes = [number_at(code, job["grading"], FIRST_ROW, part) for part in range(4)]
        self._table, self._sides = job["table"], [job.part("table_sides", axis) for axis in range(2)]

    def of_share(self, s: Value, share: Value, gradient: Vector) -> Class:
        """Of shares of slabs."""
        entry = self._entry(s, self._magnitudes.of(gradient))
        opacity = slab_opacity(self._code, self._unit_opacity(entry), share * self._units)
        return Class(opacity, self._colour(s, entry))

    def of_unit(self, s: Value, gradient: Vector) -> Class:
        """Of unit lengths."""
        entry = self._entry(s, self._magnitudes.of(gradient))
        return Class(self._unit_opacity(entry), self._colour(s, entry))

    def _unit_opacity(self, entry: list[Value]) -> Value:
        return self._code.within(entry[3], 0.0, BELOW_ONE)

    def _colour(self, s: Value, entry: list[Value]) -> Vector:
        r, g, b = entry[:3]
        return (r, g, b) if self._has_colour else self._classifier.of_slab(s).colour

    def _entry(self, s: Value, magnitude: Value) -> list[Value]:
        """Between four entries of the table."""
        code, (low, columns, least, per_row) = self._code, self._axes
        x, right, x_share = self._place((s - low) * columns, self._sides[0])
        y, below, y_share = self._place((magnitude - least) * per_row, self._sides[1])
        lines = []
        for line in (y, below):
            near, far = (rows(code, self._table, line * self._sides[0] + at, 4) for at in (x, right))
            lines.append([code.fma(b - a, x_share, a) for a, b in zip(near, far, strict=True)])
        return [code.fma(b - a, y_share, a) for a, b in zip(*lines, strict=True)]

    def _place(self, at: Value, count: Value) -> tuple[Value, Value, Value]:
        """Which entry is before a place and which behind it, and how far it is between them."""
        code, last = self._code, count - 1
        inside = code.within(at, 0.0, last.to(at.element))
        first = inside.to(I32)
        return first, code.least(first + 1, last), inside - first.to(at.element)
