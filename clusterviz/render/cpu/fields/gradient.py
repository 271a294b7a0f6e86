"""Gradients of the field, in units of clim per voxel: the twins of gradient.glsl and gradient_nearest.glsl.

They are central differences of voxels. Where a neighbour lies outside of the volume, or is invalid, they are one-sided.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import F32, Value, Vector
from clusterviz.render.cpu.fields.field import LARGEST, Corners, Field, Spot
from clusterviz.render.cpu.job import Job

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


class Gradient(Protocol):
    """The gradient of a kernel's field."""

    def at(self, spot: Spot) -> Vector:
        """Of the field at spots, each of which has a scalar; anything elsewhere."""


@dataclass(frozen=True)
class _Cell:
    """Cells, or voxels, of the volume.

    Attributes
    ----------
    voxel : int64, address of the first corner
    beyond : float32, how far the place lies from it
    begins, ends : masks along x, y, z: whether the volume has nothing before it, or nothing behind it
    """

    voxel: Value
    beyond: Vector
    begins: Vector
    ends: Vector


def _cell_of(code: Code, field: Field, spot: Spot, last: list[Value]) -> _Cell:
    """The cell of a place, one of the volume; `last`, of them, along x, y, z."""
    low, high = [], []
    for axis in range(3):
        low.append(code.most(spot.low[axis], (0 - spot.cell[axis]).to(F32)))
        high.append(code.least(spot.high[axis], (last[axis] - spot.cell[axis]).to(F32)))
    inside = replace(spot, low=(low[0], low[1], low[2]), high=(high[0], high[1], high[2]))
    cell, beyond, voxel = field.within(inside)
    begins = [at <= (0 - first).to(F32) for at, first in zip(cell, spot.cell, strict=True)]
    ends = [at >= (end - first).to(F32) for at, first, end in zip(cell, spot.cell, last, strict=True)]
    return _Cell(voxel, beyond, (begins[0], begins[1], begins[2]), (ends[0], ends[1], ends[2]))


class CentralGradient:
    """Of a field between voxels that is interpolated linearly: derivatives at voxels, interpolated likewise.

    One-sided ones are of three voxels, as exact as the others: of the two derivatives at the ends of an edge, the mean
    is then the edge's own slope. Corners that are read twice, or not needed, cost nothing: the compiler drops them.
    """

    def __init__(self, code: Code, job: Job, field: Field) -> None:
        self._code, self._field = code, field
        self._last = [job.part("cells", axis) - 1 for axis in range(3)]

    def at(self, spot: Spot) -> Vector:
        """Of the field at spots."""
        field, cell = self._field, _cell_of(self._code, self._field, spot, self._last)
        here, half = field.corners(cell.voxel), 0.5 * field.scale
        x, y, z = (half * self._along(axis, cell, here) for axis in range(3))
        return x, y, z

    def _along(self, axis: int, cell: _Cell, here: Corners) -> Value:
        """Twice the derivative along an axis: at both ends of the cell's four edges, and between them."""
        code, bit = self._code, 1 << axis
        after, before = (self._field.corners(cell.voxel, _beside(axis, way)) for way in (1, -1))
        low = [corner for corner in range(8) if not corner & bit]
        edges = [
            (here[at | bit] - before[at], after[at | bit] - here[at], 2.0 * (here[at | bit] - here[at])) for at in low
        ]
        begins, ends = cell.begins[axis], cell.ends[axis]
        if self._field.may_be_invalid:
            none = [(begins | self._invalid(before[at]), ends | self._invalid(after[at | bit])) for at in low]
            edges = [(*self._one_sided(*edge, *missing), edge[2]) for edge, missing in zip(edges, none, strict=True)]
        for aside in (cell.beyond[other] for other in range(3) if other != axis):
            pairs = zip(edges[::2], edges[1::2], strict=True)
            edges = [
                tuple(code.fma(b - a, aside, a) for a, b in zip(near, far, strict=True))  # type: ignore[misc]
                for near, far in pairs
            ]
        first, last, edge = edges[0]
        if not self._field.may_be_invalid:
            first, last = self._one_sided(first, last, edge, begins, ends)
        return code.fma(last - first, cell.beyond[axis], first)

    def _one_sided(
        self, first: Value, last: Value, edge: Value, none_before: Value, none_after: Value
    ) -> tuple[Value, Value]:
        """Both ends' derivatives, where a neighbour may be missing."""
        code = self._code
        known_first, known_last = code.select(none_before, edge, first), code.select(none_after, edge, last)
        first = code.select(none_before, 2.0 * edge - known_last, known_first)
        return first, code.select(none_after, 2.0 * edge - known_first, known_last)

    def _invalid(self, voxel: Value) -> Value:
        return ~(self._code.size(voxel) <= LARGEST)


class NearestGradient:
    """At the nearest voxel; beside one that is missing it is the difference to the other neighbour."""

    def __init__(self, code: Code, job: Job, field: Field) -> None:
        self._code, self._field = code, field
        self._last = [job.part("cells", axis) for axis in range(3)]

    def at(self, spot: Spot) -> Vector:
        """Of the field at spots."""
        cell = _cell_of(self._code, self._field, spot, self._last)
        here = self._field.corners(cell.voxel)[0]
        x, y, z = (self._field.scale * self._along(axis, cell, here) for axis in range(3))
        return x, y, z

    def _along(self, axis: int, cell: _Cell, here: Value) -> Value:
        code, none, found = self._code, [], []
        for sign, missing in ((-1, cell.begins[axis]), (1, cell.ends[axis])):
            voxel = self._field.corners(cell.voxel, _beside(axis, sign))[0]
            if self._field.may_be_invalid:
                missing = missing | ~(code.size(voxel) <= LARGEST)
            none.append(missing)
            found.append(code.select(missing, here, voxel))
        difference = found[1] - found[0]
        return code.select(none[0] ^ none[1], difference, 0.5 * difference)


def _beside(axis: int, way: int) -> tuple[int, int, int]:
    """So many voxels further on along an axis."""
    x, y, z = (way if other == axis else 0 for other in range(3))
    return x, y, z
