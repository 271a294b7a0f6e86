"""Lights on a volume: the twin of lights.glsl, lights_far.glsl and lights_near.glsl.

Ambient, diffuse and specular light on both sides of a surface. The rows are those of `Shading.block` (plan/shading.py).

References
----------
B. T. Phong: Illumination for computer generated pictures, CACM 18(6), 1975.
"""

from __future__ import annotations

from typing import Literal

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, I64, Value, Vector
from clusterviz.render.vectors.field import Spot
from clusterviz.render.vectors.job import Job
from clusterviz.render.vectors.opacity import power

Light = Literal["", "far", "near"]
"""None; all are far away or at the eye; some have a place."""
ROW_BYTES = 16
HEAD_ROWS = 7
LIGHT_ROWS = {"far": 2, "near": 5}


class Lights:
    """The lights of a kernel.

    Parameters
    ----------
    near : some have a place
    """

    def __init__(self, code: Code, job: Job, near: bool) -> None:
        self._code, self._near = code, near
        self._rows, self._count = job["lighting"], job["lights"]
        self._light_bytes = ROW_BYTES * LIGHT_ROWS["near" if near else "far"]
        self._world, self._normal = ([self._vector(self._rows, first + k) for k in range(3)] for first in (0, 3))
        self._ambient, self._diffuse, self._specular, self._power = (
            self._number(self._rows, HEAD_ROWS - 1, part) for part in range(4)
        )

    def lit(self, colour: Vector, gradient: Vector, spot: Spot, slab: Vector) -> Vector:
        """Straight colours under the lights.

        Parameters
        ----------
        gradient : of the field, per voxel
        slab : along the ray, in index space
        """
        code = self._code
        eye = self._unit(self._turned(self._world, self._scaled(slab)[0]))
        eye = -eye[0], -eye[1], -eye[2]
        normal = self._unit(self._turned(self._normal, gradient))
        toward = _dot(code, normal, eye)
        sums = [Variable(code.same(F32, 0.0)) for _ in range(6)]
        number = Variable(code.number(I32, 0))
        with code.loop(lambda: number.now < self._count):
            row = self._rows + ROW_BYTES * HEAD_ROWS + number.now.to(I64) * self._light_bytes
            light, strength = self._toward_light(row, eye, spot)
            facing = _dot(code, normal, light)
            mirrored = code.most(2.0 * facing * toward - _dot(code, light, eye), 0.0)
            highlight = power(code, code.least(mirrored, 1.0), self._power)
            highlight = code.select(facing.equals(0.0), 0.0, highlight)
            for channel in range(3):
                for part, share in ((sums[channel], code.size(facing)), (sums[3 + channel], highlight)):
                    part.set(code.fma(share, strength[channel], part.now))
            number.set(number.now + 1)
        r, g, b = (self._shown(colour[k], sums[k].now, sums[3 + k].now) for k in range(3))
        return r, g, b

    def _shown(self, colour: Value, diffuse: Value, specular: Value) -> Value:
        """One channel, cut at 1."""
        code = self._code
        shade = code.fma(self._diffuse, diffuse, self._ambient)
        return code.least(code.fma(colour, shade, self._specular * specular), 1.0)

    def _toward_light(self, row: Value, eye: Vector, spot: Spot) -> tuple[Vector, Vector]:
        """Unit vectors towards a light, and what arrives of it."""
        code = self._code
        direction, kind = self._vector(row, 0), self._number(row, 0, 3)
        x, y, z = (code.select(kind.equals(0.0), a, b) for a, b in zip(direction, eye, strict=True))
        strength = self._vector(row, 1)
        if not self._near:
            return (x, y, z), strength
        light = [Variable(part) for part in (x, y, z)]
        arriving = Variable(code.same(F32, 1.0))
        with code.when(self._is_near(row)):
            toward, share = self._from_place(row, direction, spot)
            for part, value in zip(light, toward, strict=True):
                part.set(value)
            arriving.set(share)
        r, g, b = (arriving.now * part for part in strength)
        return (light[0].now, light[1].now, light[2].now), (r, g, b)

    def _is_near(self, row: Value) -> Value:
        return self._code.load(F32, row + 12) > 1.0

    def _from_place(self, row: Value, direction: Vector, spot: Spot) -> tuple[Vector, Value]:
        """The same for one with a place, told as whole voxels and a rest: so nothing is lost in a large volume."""
        code = self._code
        whole, rest, powers = (self._vector(row, k) for k in (2, 3, 4))
        x, y, z = (
            (at - cell.to(F32)) + (more - beyond)
            for at, cell, more, beyond in zip(whole, spot.cell, rest, spot.beyond, strict=True)
        )
        scaled, largest = self._scaled(self._turned(self._world, (x, y, z)))
        length = code.call("sqrt", _dot(code, scaled, scaled))
        way, share = largest * length, code.select(length > 0.0, 1.0 / code.most(length, 1e-30), 0.0)
        toward = scaled[0] * share, scaled[1] * share, scaled[2] * share
        along = _dot(code, toward, direction)
        inside = along >= self._number(row, 2, 3)
        cone = power(code, code.within(along, 0.0, 1.0), self._number(row, 1, 3))
        fall = code.fma(way, code.fma(way, powers[2], powers[1]), powers[0])
        return toward, code.select(inside, cone, 0.0) / code.most(fall, 1e-30)

    def _unit(self, vector: Vector) -> Vector:
        """At length 1; the zero vector stays."""
        code, (scaled, _) = self._code, self._scaled(vector)
        square = _dot(code, scaled, scaled)
        share = code.select(square > 0.0, 1.0 / code.call("sqrt", code.most(square, 0.5)), 0.0)
        return scaled[0] * share, scaled[1] * share, scaled[2] * share

    def _scaled(self, vector: Vector) -> tuple[Vector, Value]:
        """Over its largest part, and that: the square of a steep gradient, or of a long way, would leave float32."""
        code = self._code
        x, y, z = (code.size(part) for part in vector)
        largest = code.most(x, code.most(y, z))
        safe = code.select(largest > 0.0, largest, 1.0)
        return (vector[0] / safe, vector[1] / safe, vector[2] / safe), largest

    def _turned(self, columns: list[Vector], vector: Vector) -> Vector:
        """A matrix times a vector."""
        code, (a, b, c) = self._code, columns
        x, y, z = (code.fma(c[k], vector[2], code.fma(b[k], vector[1], a[k] * vector[0])) for k in range(3))
        return x, y, z

    def _number(self, rows: Value, row: int, part: int) -> Value:
        return self._code.splat(self._code.load(F32, rows + (ROW_BYTES * row + 4 * part)))

    def _vector(self, rows: Value, row: int) -> Vector:
        x, y, z = (self._number(rows, row, part) for part in range(3))
        return x, y, z


def _dot(code: Code, a: Vector, b: Vector) -> Value:
    return code.fma(a[2], b[2], code.fma(a[1], b[1], a[0] * b[0]))
