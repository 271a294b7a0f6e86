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
from clusterviz.render.cpu.fields.field import Spot
from clusterviz.render.cpu.fields.gradient import (
    ROW_BYTES,
    dot,
    length,
    number_at,
    scaled,
    turned,
    unit,
    vector_at,
)
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.transfer.classify import power

Light = Literal["", "far", "near"]
"""None; all are far away or at the eye; some have a place."""
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
        self._rows, self._count, self._caps = job["lighting"], job["lights"], job["caps"]
        self._light_bytes = ROW_BYTES * LIGHT_ROWS["near" if near else "far"]
        self._world, self._normal = ([vector_at(code, self._rows, first + k) for k in range(3)] for first in (0, 3))
        self._ambient, self._diffuse, self._specular, self._power = (
            number_at(code, self._rows, HEAD_ROWS - 1, part) for part in range(4)
        )
        self._least = number_at(code, self._rows, 3, 3)

    def lit(self, colour: Vector, gradient: Vector, spot: Spot, slab: Vector, capped: bool) -> Vector:
        """Straight colours under the lights.

        Parameters
        ----------
        gradient : of the field, per voxel
        slab : along the ray, in index space
        capped : what is next to a cut face is lit as the face is, by a share that falls with the way behind it, and
            with the gradient
        """
        code = self._code
        eye = unit(code, turned(code, self._world, scaled(code, slab)[0]))
        eye = -eye[0], -eye[1], -eye[2]
        steep = turned(code, self._normal, gradient)
        normal = unit(code, steep)
        share, cap = self._cap(length(code, steep), spot) if capped else (None, normal)
        sums = [Variable(code.same(F32, 0.0)) for _ in range(6)]
        number = Variable(code.number(I32, 0))
        with code.loop(lambda: number.now < self._count):
            row = self._rows + ROW_BYTES * HEAD_ROWS + number.now.to(I64) * self._light_bytes
            light, strength = self._toward_light(row, eye, spot)
            shares = [Variable(part) for part in self._reflected(normal, light, eye)]
            if share is not None:
                with code.when(code.any(share > 0.0)):
                    for part, other in zip(shares, self._reflected(cap, light, eye), strict=True):
                        part.set(code.fma(share, other - part.now, part.now))
            for channel in range(3):
                for part, each in ((sums[channel], shares[0].now), (sums[3 + channel], shares[1].now)):
                    part.set(code.fma(each, strength[channel], part.now))
            number.set(number.now + 1)
        r, g, b = (self._shown(colour[k], sums[k].now, sums[3 + k].now) for k in range(3))
        return r, g, b

    def _reflected(self, normal: Vector, light: Vector, eye: Vector) -> tuple[Value, Value]:
        """What a surface reflects of a light to the eye: diffuse and specular shares."""
        code, facing = self._code, dot(self._code, normal, light)
        mirrored = code.most(2.0 * facing * dot(code, normal, eye) - dot(code, light, eye), 0.0)
        highlight = power(code, code.least(mirrored, 1.0), self._power)
        return code.size(facing), code.select(facing.equals(0.0), 0.0, highlight)

    def _cap(self, steepness: Value, spot: Spot) -> tuple[Value, Vector]:
        """The share of a cut face's light, and the face's normal: of the one with the largest share."""
        code = self._code
        share, cap = Variable(code.same(F32, 0.0)), [Variable(code.same(F32, 0.0)) for _ in range(3)]
        x, y, z = (cell.to(F32) + beyond for cell, beyond in zip(spot.cell, spot.beyond, strict=True))
        number, first = Variable(code.number(I32, 0)), self._rows + ROW_BYTES * HEAD_ROWS
        with code.when(code.any(steepness * self._least < 1.0)):
            first = first + self._count.to(I64) * self._light_bytes
            with code.loop(lambda: number.now < self._caps):
                row = first + number.now.to(I64) * (2 * ROW_BYTES)
                behind = dot(code, vector_at(code, row, 1), (x, y, z)) + number_at(code, row, 1, 3)
                even = 1.0 - steepness * number_at(code, row, 0, 3)
                found = even * code.within(1.0 - behind, 0.0, 1.0)
                larger = found > share.now
                share.set(code.select(larger, found, share.now))
                for part, value in zip(cap, vector_at(code, row, 0), strict=True):
                    part.set(code.select(larger, value, part.now))
                number.set(number.now + 1)
        return share.now, (cap[0].now, cap[1].now, cap[2].now)

    def _shown(self, colour: Value, diffuse: Value, specular: Value) -> Value:
        """One channel, cut at 1."""
        code = self._code
        shade = code.fma(self._diffuse, diffuse, self._ambient)
        return code.least(code.fma(colour, shade, self._specular * specular), 1.0)

    def _toward_light(self, row: Value, eye: Vector, spot: Spot) -> tuple[Vector, Vector]:
        """Unit vectors towards a light, and what arrives of it."""
        code = self._code
        direction, kind = vector_at(code, row, 0), number_at(code, row, 0, 3)
        x, y, z = (code.select(kind.equals(0.0), a, b) for a, b in zip(direction, eye, strict=True))
        strength = vector_at(code, row, 1)
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
        whole, rest, powers = (vector_at(code, row, k) for k in (2, 3, 4))
        x, y, z = (
            (at - cell.to(F32)) + (more - beyond)
            for at, cell, more, beyond in zip(whole, spot.cell, rest, spot.beyond, strict=True)
        )
        small, largest = scaled(code, turned(code, self._world, (x, y, z)))
        distance = code.call("sqrt", dot(code, small, small))
        way, share = largest * distance, code.select(distance > 0.0, 1.0 / code.most(distance, 1e-30), 0.0)
        toward = small[0] * share, small[1] * share, small[2] * share
        along = dot(code, toward, direction)
        inside = along >= number_at(code, row, 2, 3)
        cone = power(code, code.within(along, 0.0, 1.0), number_at(code, row, 1, 3))
        fall = code.fma(way, code.fma(way, powers[2], powers[1]), powers[0])
        return toward, code.select(inside, cone, 0.0) / code.most(fall, 1e-30)
