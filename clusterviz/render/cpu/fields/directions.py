"""Directions and lengths in float32 that cannot overflow: the square of a steep gradient, or of a long way, would."""

from __future__ import annotations

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import F32, Value, Vector

ROW_BYTES = 16


def unit(code: Code, vector: Vector) -> Vector:
    """At length 1; the zero vector stays."""
    small, _ = scaled(code, vector)
    square = dot(code, small, small)
    share = code.select(square > 0.0, 1.0 / code.call("sqrt", code.most(square, 0.5)), 0.0)
    return small[0] * share, small[1] * share, small[2] * share


def length(code: Code, vector: Vector) -> Value:
    """Of vectors."""
    small, largest = scaled(code, vector)
    return largest * code.call("sqrt", dot(code, small, small))


def scaled(code: Code, vector: Vector) -> tuple[Vector, Value]:
    """Over the largest of its parts, and that."""
    x, y, z = (code.size(part) for part in vector)
    largest = code.most(x, code.most(y, z))
    safe = code.select(largest > 0.0, largest, 1.0)
    return (vector[0] / safe, vector[1] / safe, vector[2] / safe), largest


def turned(code: Code, columns: list[Vector], vector: Vector) -> Vector:
    """A matrix times a vector."""
    a, b, c = columns
    x, y, z = (code.fma(c[k], vector[2], code.fma(b[k], vector[1], a[k] * vector[0])) for k in range(3))
    return x, y, z


def dot(code: Code, a: Vector, b: Vector) -> Value:
    """The inner product."""
    return code.fma(a[2], b[2], code.fma(a[1], b[1], a[0] * b[0]))


def number_at(code: Code, rows: Value, row: int, part: int) -> Value:
    """One of the four numbers of a row of a block, for all lanes."""
    return code.splat(code.load(F32, rows + (ROW_BYTES * row + 4 * part)))


def vector_at(code: Code, rows: Value, row: int) -> Vector:
    """The first three."""
    x, y, z = (number_at(code, rows, row, part) for part in range(3))
    return x, y, z
