"""Cubic B-splines: the twin of spline.glsl, cubic.glsl and gradient_cubic.glsl.

The 64 voxels around a place are eight cells, two along each axis. Each is fetched as ever, and of 8-bit voxels that is
one load. Sums run along x, then y, then z. An invalid voxel counts as the corner of the place's own cell next to it.
Voxels are taken as differences from one of them, so that a constant field stays constant.

References
----------
C. Sigg, M. Hadwiger: Fast third-order texture filtering, GPU Gems 2, 2005, chapter 20 (the weights).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, Value, Vector
from clusterviz.render.cpu.fields.field import LARGEST, Cubic, Field, Spot, extremes

TAPS = range(4)
WAYS = [(x, y, z) for x, y, z in product((-1, 1), repeat=3)]
Weights = tuple[Value, Value, Value, Value]
Block = list[list[list[Value]]]


class CubicField(Field):
    """The field of cubic B-splines."""

    def at(self, spot: Spot) -> Value:
        """The scalar, in units of clim; NaN where a corner of the cell is invalid."""
        code, (_, beyond, voxel) = self._code, self.within(spot)
        x, y, z = (weights(code, t) for t in beyond)
        block, base = apart(code, self, voxel)
        layers = [summed(code, y, [summed(code, x, row) for row in layer]) for layer in block]
        return self.scalar(base + summed(code, z, layers))

    def extent(self, voxel: Value) -> tuple[Value, Value, Value]:
        """Of 64 voxels: splines stay between those."""
        block, base = apart(self._code, self, voxel)
        own = [row[x] for layer in block[1:3] for row in layer[1:3] for x in (1, 2)]
        low, high = extremes(self._code, [voxel for layer in block for row in layer for voxel in row])
        return self.scalar(base + low), self.scalar(base + high), self.known(own)

    def cubic(self, voxel: Value, at: Sequence[Value], way: Sequence[Value]) -> Cubic:
        """Nearly the field along ways through cells: what it is at their ends, and at thirds of them."""
        code, number, (block, base) = self._code, Variable(self._code.number(I32, 0)), apart(self._code, self, voxel)
        found = [Variable(code.same(F32, 0.0)) for _ in TAPS]
        with code.loop(lambda: number.now < len(TAPS)):
            share = code.splat(number.now.to(F32) * (1.0 / 3.0))
            x, y, z = (weights(code, code.fma(by, share, begin)) for begin, by in zip(at, way, strict=True))
            layers = [summed(code, y, [summed(code, x, row) for row in layer]) for layer in block]
            s = summed(code, z, layers)
            for k, place in enumerate(found):
                place.set(code.select(code.splat(number.now).equals(k), s, place.now))
            number.set(number.now + 1)
        a, b, c, d = (self.scale * place.now for place in found)
        slope = 0.5 * code.fma(2.0, d, code.fma(-9.0, c, code.fma(18.0, b, -11.0 * a)))
        bend = 4.5 * (code.fma(4.0, c, 2.0 * a) - code.fma(5.0, b, d))
        return self.scalar(base) + a, slope, bend, 4.5 * code.fma(3.0, b - c, d - a)


class CubicGradient:
    """The derivative of cubic B-splines, in units of clim per voxel."""

    def __init__(self, code: Code, field: Field) -> None:
        self._code, self._field = code, field

    def at(self, spot: Spot) -> Vector:
        """At spots."""
        code, field, (_, beyond, voxel) = self._code, self._field, self._field.within(spot)
        (x, y, z), (dx, dy, dz) = (tuple(of(code, t) for t in beyond) for of in (weights, slopes))
        block, _ = apart(code, field, voxel)
        along = [[summed(code, x, row) for row in layer] for layer in block]
        across = [[summed(code, dx, row) for row in layer] for layer in block]
        gradient = (
            summed(code, z, [summed(code, y, layer) for layer in across]),
            summed(code, z, [summed(code, dy, layer) for layer in along]),
            summed(code, dz, [summed(code, y, layer) for layer in along]),
        )
        east, north, up = (field.scale * part for part in gradient)
        return east, north, up


def apart(code: Code, field: Field, voxel: Value) -> tuple[Block, Value]:
    """The 64 voxels by [z][y][x] less the cell's first corner, as stored, and that corner."""
    cells = {way: field.corners(voxel, way) for way in WAYS}
    near = field.corners(voxel)
    base = near[0]

    def tap(x: int, y: int, z: int) -> Value:
        x_way, y_way, z_way = (2 * (at >> 1) - 1 for at in (x, y, z))
        found = cells[x_way, y_way, z_way][(x & 1) + 2 * (y & 1) + 4 * (z & 1)]
        if field.may_be_invalid:
            # The corner of the cell that is next to it.
            right, down, deep = (int(at > 1) for at in (x, y, z))
            found = code.select(code.size(found) <= LARGEST, found, near[right + 2 * down + 4 * deep])
        return found - base

    return [[[tap(x, y, z) for x in TAPS] for y in TAPS] for z in TAPS], base


def weights(code: Code, t: Value) -> Weights:
    """The four B-splines that meet in a cell, at a share of it."""
    u, sixth = 1.0 - t, 1.0 / 6.0
    t2, u2 = t * t, u * u
    first, last = sixth * u2 * u, sixth * t2 * t
    second = code.fma(0.5 * t2, t - 2.0, 4.0 * sixth)
    return first, second, code.fma(0.5 * u2, u - 2.0, 4.0 * sixth), last


def slopes(code: Code, t: Value) -> Weights:
    """Their derivatives."""
    u = 1.0 - t
    return -0.5 * (u * u), 0.5 * t * (3.0 * t - 4.0), 0.5 * u * (4.0 - 3.0 * u), 0.5 * (t * t)


def summed(code: Code, by: Weights, values: list[Value]) -> Value:
    """A weighted sum of four."""
    found = by[0] * values[0]
    for weight, value in zip(by[1:], values[1:], strict=True):
        found = code.fma(weight, value, found)
    return found
