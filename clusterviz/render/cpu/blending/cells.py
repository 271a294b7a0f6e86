"""The cells that rays pass, one after another: where they enter and leave each, and between which scalars it lies.

Cells are those in which the field is one polynomial; of nearest voxels these are the voxels, half a cell before their
corners. A ray's way through a cell is found by one expression, wherever its run begins or ends.

References
----------
J. Amanatides, A. Woo: A fast voxel traversal algorithm for ray tracing, Eurographics 1987, section 2.
"""

from __future__ import annotations

from dataclasses import replace

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, Value, Vector
from clusterviz.render.cpu.fields.field import Cubic, Field, Spot
from clusterviz.render.cpu.job import Job

FAR = 3e38
EARLIER = 1e-4  # slabs before a run; where it begins on a face, the cell before that face tells what is met at it
STILL = 1e-30  # voxels a slab; rays that are slower along an axis do not move


class Cells:
    """The way of rays through cells.

    Parameters
    ----------
    line : spots, and slabs in voxels
    begin : how many slabs on from the spots
    """

    def __init__(self, code: Code, job: Job, field: Field, line: tuple[Spot, Vector], begin: Value) -> None:
        self._code, self._field, (self._spot, slab) = code, field, line
        shift, self._faces, self._steps, cells = 0.5 * field.is_nearest, [], [], []
        enters = code.same(F32, -FAR)
        for by, at in zip(slab, self._spot.beyond, strict=True):
            moves, rises = code.size(by) > STILL, by > 0.0
            per_voxel = code.select(moves, 1.0 / code.select(moves, by, 1.0), 0.0)
            offset, up = (-shift - at) * per_voxel, code.select(rises, code.same(F32, 1.0), 0.0)
            cell = code.call("floor", code.fma(begin - EARLIER, by, at) + shift)
            met = code.fma(cell + (1.0 - up), per_voxel, offset)
            enters = code.most(code.select(moves, met, -FAR), enters)
            self._faces.append((up, per_voxel, code.select(moves, offset, FAR)))
            self._steps.append(2.0 * up - 1.0)
            cells.append(Variable(cell))
        self._cells, self._enters = cells, Variable(enters)
        self._low, self._high = self._in_volume(job)

    def _in_volume(self, job: Job) -> tuple[list[Value], list[Value]]:
        """How far cells may be moved that are of the brick and of the volume."""
        code, spot, low, high = self._code, self._spot, [], []
        for axis, cell in enumerate(spot.cell):
            last = job.part("cells", axis) - int(not self._field.is_nearest)
            low.append(code.most(spot.low[axis], (0 - cell).to(F32)))
            high.append(code.least(spot.high[axis], (last - cell).to(F32)))
        return low, high

    @property
    def enters(self) -> Value:
        """Where rays enter the cells that they are in, in slabs from the spots."""
        return self._enters.now

    @property
    def here(self) -> Spot:
        """The spots, as seen in these cells: rounding takes no place out of them."""
        x, y, z = self._whole()
        return replace(self._spot, low=(x, y, z), high=(x, y, z))

    def extent(self) -> tuple[Value, Value, Value]:
        """Between which scalars the field lies in these cells, and whether they have one."""
        return self._field.extent(self._field.first_corner(self._spot, self._whole()))

    def cubic(self, slab: Vector, leaves: Value) -> Cubic:
        """The field along the way through these cells, from 0 to 1; of splines, one that is nearly it."""
        code, cells = self._code, self._whole()
        length = leaves - self.enters
        spot = zip(slab, self._spot.beyond, cells, strict=True)
        at = [code.fma(self.enters, by, beyond - cell) for by, beyond, cell in spot]
        return self._field.cubic(self._field.first_corner(self._spot, cells), at, [length * by for by in slab])

    def _whole(self) -> list[Value]:
        parts = zip(self._cells, self._low, self._high, strict=True)
        return [self._code.within(cell.now, low, high) for cell, low, high in parts]

    def leave(self) -> tuple[Value, list[Value]]:
        """Where rays leave these cells, and where the faces before them lie along each axis."""
        code, found, faces = self._code, self._code.same(F32, FAR), []
        for cell, (up, per_voxel, offset) in zip(self._cells, self._faces, strict=True):
            faces.append(code.fma(cell.now + up, per_voxel, offset))
            found = code.least(faces[-1], found)
        return code.most(found, self.enters), faces

    def go_on(self, leaves: Value, faces: list[Value], going: Value) -> None:
        """Go to the next cells."""
        code = self._code
        for cell, face, step in zip(self._cells, faces, self._steps, strict=True):
            cell.set(code.select(going & (face <= leaves), cell.now + step, cell.now))
        self._enters.set(code.select(going, leaves, self._enters.now))
