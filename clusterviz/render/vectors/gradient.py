"""Gradients of the field, in units of clim per voxel: the twins of gradient.glsl and gradient_differences.glsl."""

from __future__ import annotations

from typing import Protocol

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import Value, Vector
from clusterviz.render.vectors.field import Corners, Field, Spot
from clusterviz.render.vectors.samples import LARGEST

AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


class Gradient(Protocol):
    """The gradient of a kernel's field."""

    def at(self, spot: Spot) -> Vector:
        """Of the field at spots, each of which has a scalar; anything elsewhere."""


class CentralGradient:
    """Of a field between voxels that is interpolated linearly: central differences of voxels, interpolated likewise.

    What lies outside of the volume, or is invalid, repeats its neighbour in the cell. Corners that are read twice, or
    not needed, cost nothing: the compiler drops them.
    """

    def __init__(self, code: Code, field: Field) -> None:
        self._code, self._field = code, field

    def at(self, spot: Spot) -> Vector:
        """Of the field at spots."""
        field, (beyond, voxel) = self._field, self._field.within(spot)
        here, half = field.corners(voxel), 0.5 * field.scale
        x, y, z = (half * self._along(axis, beyond, voxel, here) for axis in range(3))
        return x, y, z

    def _along(self, axis: int, beyond: Vector, voxel: Value, here: Corners) -> Value:
        """Twice the difference along an axis: for the cell's four edges along it, then between them."""
        field, code, bit = self._field, self._code, 1 << axis
        before, after = (
            self._valid(field.corners(field.beside(voxel, *(sign * part for part in AXES[axis]))), here)
            for sign in (-1, 1)
        )
        edges = []
        for low in (corner for corner in range(8) if not corner & bit):
            high = low | bit
            start = here[high] - before[low]
            edges.append(code.fma((after[high] - here[low]) - start, beyond[axis], start))
        for aside in (beyond[other] for other in range(3) if other != axis):
            edges = [code.fma(far - near, aside, near) for near, far in zip(edges[::2], edges[1::2], strict=True)]
        return edges[0]

    def _valid(self, corners: Corners, here: Corners) -> Corners:
        if not self._field.may_be_invalid:
            return corners
        pairs = zip(corners, here, strict=True)
        return tuple(self._code.select(self._code.size(found) <= LARGEST, found, other) for found, other in pairs)


class NearestGradient:
    """Between nearest voxels: half of the difference of the voxels to either side; an invalid one is no different."""

    def __init__(self, code: Code, field: Field) -> None:
        self._code, self._field = code, field

    def at(self, spot: Spot) -> Vector:
        """Of the field at spots."""
        field, half = self._field, 0.5 * self._field.scale
        voxel = field.within(spot)[1]
        x, y, z = (half * (self._beside(voxel, axis, 1) - self._beside(voxel, axis, -1)) for axis in AXES)
        return x, y, z

    def _beside(self, voxel: Value, axis: tuple[int, int, int], sign: int) -> Value:
        field, code = self._field, self._code
        found = field.corners(field.beside(voxel, *(sign * part for part in axis)))[0]
        if not field.may_be_invalid:
            return found
        return code.select(code.size(found) <= LARGEST, found, field.corners(voxel)[0])
