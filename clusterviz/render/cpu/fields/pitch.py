"""How far apart the rows and layers of voxels lie, in voxels: alike in all bricks, or as each brick's size has it."""

from __future__ import annotations

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I32, I64, Value, Vector
from clusterviz.render.cpu.job import Job


class Pitch:
    """The pitch of bricks of one size."""

    def __init__(self, code: Code, job: Job) -> None:
        self._code, self._job = code, job
        self._row_real, self._layer_real = (code.splat(job[name]).to(F32) for name in ("row", "layer"))
        self._row, self._layer = (job[name].to(I64) for name in ("row", "layer"))

    def enter(self, brick: Value) -> None:
        """What follows is asked of these bricks, given by their numbers in the box."""

    def voxel(self, local: Vector) -> Value:
        """The number of a voxel in its brick, of the job's `word`."""
        x, y, z = local
        return (z * self._job["layer"] + y * self._job["row"] + x).to(self._job.word)

    def away(self, cell: Vector) -> Value:
        """How many voxels further on a cell is, as seen from another; float32, for whole numbers below 2^24."""
        return self._code.fma(cell[2], self._layer_real, self._code.fma(cell[1], self._row_real, cell[0]))

    def beside(self, voxel: Value, x: int, y: int, z: int) -> tuple[Value, Value | int]:
        """A neighbour of voxels as a number of each lane, and what is to be added in all lanes."""
        return voxel, self._row * y + self._layer * z + x


class BrickPitch(Pitch):
    """The pitch of bricks of several sizes; each lane is in a brick of its own."""

    def __init__(self, code: Code, job: Job) -> None:
        super().__init__(code, job)
        self._pitch = [Variable(code.same(I32, 0)) for _ in range(2)]

    def enter(self, brick: Value) -> None:
        """See `Pitch`."""
        for number, pitch in enumerate(self._pitch):
            pitch.set(self._code.gather(I32, self._job["pitches"], brick * 2 + number, 4))

    def voxel(self, local: Vector) -> Value:
        """See `Pitch`."""
        (x, y, z), (row, layer) = local, self._pitch
        return (z * layer.now + y * row.now + x).to(self._job.word)

    def away(self, cell: Vector) -> Value:
        """See `Pitch`."""
        row, layer = (pitch.now.to(F32) for pitch in self._pitch)
        return self._code.fma(cell[2], layer, self._code.fma(cell[1], row, cell[0]))

    def beside(self, voxel: Value, x: int, y: int, z: int) -> tuple[Value, Value | int]:
        """See `Pitch`."""
        row, layer = (pitch.now for pitch in self._pitch)
        return voxel + (row * y + layer * z + x).to(self._job.word), 0
