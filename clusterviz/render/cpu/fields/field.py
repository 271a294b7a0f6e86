"""The scalar of the field at a place in a brick, trilinear with float32 weights: the twin of linear.glsl.

Fetches are what costs. A load brings 64 bits, two neighbours along x; voxels are laid out so that these hold as many of
a cell's eight corners as fit: all of them (8-bit voxels, with those of the next row and the next layer beside each),
four (16-bit, with the next row's), or two (float32, as they are). So a voxel takes four bytes, whatever its type.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, I8, I16, I32, I64, Value, Vector, vector_of
from clusterviz.plan.encoding import VoxelKind
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


PREFETCHED = {16: (0, 3, 6, 9, 12, 15), 8: (0, 2, 5, 7), 4: (0, 3)}
"""Pixels of a packet whose voxels are asked for ahead: its corners, and some between them, tell of the others."""
HERE = (0, 0, 0)
Corners = tuple[Value, ...]
Cubic = tuple[Value, Value, Value, Value]
"""Factors of 1, t, t², t³."""
LARGEST = 3e38  # of what is a number


@dataclass(frozen=True)
class Spot:
    """Places of a packet, each relative to the corner of a cell near its brick, so that few digits are lost.

    Attributes
    ----------
    voxel : the number of the cell's first corner among all voxels, of the job's `word`
    low, high : float32, how far the cell may move along x, y, z before it leaves the brick
    beyond : float32, from the cell's corner to the place
    cell : int32, the cell's number in the volume along x, y, z
    begin : float32, how many slabs on from `beyond` those lie that are counted from here: of runs, which share the
        place with which their window begins; None: they are at the place
    """

    voxel: Value
    low: Vector
    high: Vector
    beyond: Vector
    cell: Vector
    begin: Value | None = None


class Field:
    """The voxels of a draw as its kernel reads them.

    Parameters
    ----------
    kind : how they are stored
    nearest : the nearest voxel is taken, nothing is interpolated
    pitch : of the bricks

    Attributes
    ----------
    is_nearest : the same
    """

    def __init__(self, code: Code, job: Job, kind: VoxelKind, nearest: bool, pitch: Pitch) -> None:
        self._code, self._kind, self.is_nearest, self._pitch = code, kind, nearest, pitch
        self._word, self._voxels = job.word, job["voxels"]
        self._scale, self._bias = (code.splat(job.part("scalar", k)) for k in range(2))
        self._base = code.splat(job["base"])

    def at(self, spot: Spot) -> Value:
        """The scalar, in units of clim; NaN where an invalid voxel takes part."""
        code = self._code
        _, (x, y, z), voxel = self.within(spot)
        if self.is_nearest:
            return self.scalar(self.corners(voxel)[0])
        c = self.corners(voxel)
        along = [code.fma(c[k + 1] - c[k], x, c[k]) for k in (0, 2, 4, 6)]
        near, far = (code.fma(along[k + 1] - along[k], y, along[k]) for k in (0, 2))
        return self.scalar(code.fma(far - near, z, near))

    def extent(self, voxel: Value) -> tuple[Value, Value, Value]:
        """Between which scalars the field of cells lies, by their first corners, and whether they have a field."""
        code = self._code
        if self._kind == "f32" or self.is_nearest:
            stored = list(self.corners(voxel))[: 1 if self.is_nearest else 8]
            low, high = extremes(code, stored)
            return self.scalar(low), self.scalar(high), self.known(stored)
        # Small numbers are compared as they lie, several to a word.
        element, bits, layers = (I8, 8, (0,)) if self._kind == "u8" else (I16, 16, (0, 1))
        words = [word for up in layers for word in self._pair(voxel, 0, 0, up)]
        found = []
        for name in ("umin", "umax"):
            word = words[0]
            for other in words[1:]:
                word = code.call(name, word.bits(element), other.bits(element)).bits(I32)
            for shift in (16, 8)[: 16 // bits]:
                word = code.call(name, word.bits(element), (word >> shift).bits(element)).bits(I32)
            word = word & ((1 << bits) - 1)
            found.append(self.scalar((word - self._base if self._kind == "u16" else word).to(F32)))
        return found[0], found[1], self.known([found[0]])

    def cubic(self, voxel: Value, at: Sequence[Value], way: Sequence[Value]) -> Cubic:
        """The field along ways through cells, `t` of them behind where they begin.

        Parameters
        ----------
        at, way : where they begin in the cells, and how far they go, float32 along x, y, z

        References
        ----------
        S. Parker, P. Shirley, Y. Livnat, C. Hansen, P.-P. Sloan: Interactive ray tracing for isosurface rendering,
        IEEE Visualization 1998, section 3.
        """
        code, corners, none = self._code, self.corners(voxel), self._code.same(F32, 0.0)
        if self.is_nearest:
            return self.scalar(corners[0]), none, none, none
        parts: list[list[Value]] = [[corner] for corner in corners]
        for begin, by in zip(at, way, strict=True):
            parts = [_between(code, a, b, begin, by) for a, b in zip(parts[::2], parts[1::2], strict=True)]
        first, *others = parts[0]
        slope, bend, twist = (part * self.scale for part in others)
        return self.scalar(first), slope, bend, twist

    def known(self, stored: Sequence[Value]) -> Value:
        """Whether all of some stored voxels are valid."""
        code, found = self._code, stored[0].equals(stored[0])
        if self.may_be_invalid:
            for voxel in stored:
                found = found & (code.size(voxel) <= LARGEST)
        return found

    def within(self, spot: Spot) -> tuple[list[Value], Vector, Value]:
        """Cells that places are in, as seen from the spot's, how far these lie in them, and first corners' numbers.

        Where the nearest voxel is taken, these are its own.
        """
        cell, voxel = self._cell(spot)
        x, y, z = (at - whole for at, whole in zip(spot.beyond, cell, strict=True))
        return cell, (x, y, z), voxel

    @property
    def scale(self) -> Value:
        """What differences of stored voxels are multiplied by to be in units of clim."""
        return self._code.same(F32, 1.0) if self._kind == "f32" else self._scale

    @property
    def may_be_invalid(self) -> bool:
        """Whether a voxel may be NaN."""
        return self._kind == "f32"

    def ask_for(self, spot: Spot) -> None:
        """Let the CPU bring the voxels of a later sample nearer; some of the lanes tell of all."""
        voxel = self._cell(spot)[1]
        self._code.prefetch(self._address(voxel, lane) for lane in PREFETCHED[self._code.lanes])

    def _cell(self, spot: Spot) -> tuple[list[Value], Value]:
        """Which cell places are in, as seen from the spot's, and the number of its first corner."""
        code = self._code
        rounded = tuple(at + 0.5 for at in spot.beyond) if self.is_nearest else spot.beyond
        cell = [
            code.most(code.least(code.call("floor", at), high), low)
            for at, low, high in zip(rounded, spot.low, spot.high, strict=True)
        ]
        return cell, self.first_corner(spot, cell)

    def first_corner(self, spot: Spot, cell: Sequence[Value]) -> Value:
        """The number of a cell's first corner; the cell is float32, as seen from the spot's."""
        # Whole numbers below 2^24 (the length of a run sees to that), so that float32 is exact.
        away = self._pitch.away(vector_of(cell))
        return spot.voxel + away.to(I32).to(self._word)

    def scalar(self, stored: Value) -> Value:
        """Stored voxels, or what lies between some, in units of clim."""
        return stored if self._kind == "f32" else self._code.fma(stored, self._scale, self._bias)

    def corners(self, voxel: Value, beside: tuple[int, int, int] = HERE) -> Corners:
        """The corners of a cell, as stored, float32; x fastest, then y.

        Parameters
        ----------
        voxel : the number of a voxel
        beside : how much further on along x, y, z the cell's first corner lies
        """
        x, y, z = beside
        if self._kind == "u8":
            words = self._pair(voxel, x, y, z)
            return tuple(
                ((words[k & 1] >> 8 * (k >> 1)) & 255 if k < 6 else words[k & 1] >> 24).to(F32) for k in range(8)
            )
        if self._kind == "u16":
            corners: list[Value] = []
            for words in (self._pair(voxel, x, y, z + up) for up in (0, 1)):
                corners += [(words[k & 1] & 65535 if k < 2 else words[k & 1] >> 16) - self._base for k in range(4)]
            return tuple(corner.to(F32) for corner in corners)
        pairs = [self._pair(voxel, x, y + down, z + up) for up in (0, 1) for down in (0, 1)]
        return tuple(word.bits(F32) for pair in pairs for word in pair)

    def _pair(self, voxel: Value, x: int, y: int, z: int) -> tuple[Value, Value]:
        """The 32 bits of voxels and of those behind them, along x; so much further on than a voxel of each lane.

        Loads of single numbers: where they were measured, a gather took longer.
        """
        code, lanes = self._code, self._code.lanes
        voxel, away = self._pitch.beside(voxel, x, y, z)
        loads = [code.load(I64, self._address(voxel, lane, away)) for lane in range(lanes)]
        both = code.packed(loads).bits(I32)
        low, high = (code.shuffle(both, both, range(word, 2 * lanes, 2)) for word in (0, 1))
        return low, high

    def _address(self, voxel: Value, lane: int, away: Value | int = 0) -> Value:
        """Of a lane's voxel, or one so many voxels further on: what is the same for all lanes is added first."""
        first = self._voxels if isinstance(away, int) else self._voxels + (away << 2)
        return first + (voxel.lane(lane).unsigned(I64) << 2)


def extremes(code: Code, values: Sequence[Value]) -> tuple[Value, Value]:
    """The least and the largest of some values, none of which is NaN."""
    low = high = values[0]
    for value in values[1:]:
        low, high = code.least(low, value), code.most(high, value)
    return low, high


def _between(code: Code, a: list[Value], b: list[Value], at: Value, by: Value) -> list[Value]:
    """From polynomial a to polynomial b, at + by · t of the way."""
    apart = [second - first for first, second in zip(a, b, strict=True)]
    low = [code.fma(more, at, first) for more, first in zip(apart, a, strict=True)]
    high = [more * by for more in apart]
    return [low[0], *(first + second for first, second in zip(low[1:], high[:-1], strict=True)), high[-1]]
