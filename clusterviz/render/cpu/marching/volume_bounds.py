"""Where rays and runs are in each volume of a mixture: the twin of see, face_all and begin_all in volume_layer.glsl.

Rays, slabs, bricks and groups of cells are those of the domain. Which slabs have their midpoint in a volume is decided
in double precision for the whole ray, so every box finds the same ones; where a run is in a volume's own voxels is
found from where its window begins, so it does not depend on where the run does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import BYTES, F32, F64, I32, Value, Vector, vector_of
from clusterviz.render.cpu.fields.field import Pitch, Spot
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.clip import kept_by, side_of
from clusterviz.render.cpu.marching.rays import FAR, Rays, between
from clusterviz.render.cpu.marching.sample_positions import Place, Places, Window
from clusterviz.render.cpu.marching.state import Layout, Packet
from clusterviz.render.cpu.transfer.classify import rows

SLACK = 1e-9
"""Of its length, by which a volume's box is widened: a ray along a face sees it from everywhere."""
REACH = 2.0**30  # voxels


@dataclass(frozen=True)
class RankWork:
    """Places of a packet in one volume.

    Attributes
    ----------
    spot : in its voxels
    there : whether the places' bricks hold any of them
    """

    spot: Spot
    there: Value


@dataclass(frozen=True)
class Begin:
    """Where the windows of rays begin in one volume.

    Attributes
    ----------
    cell : that holds it, int32
    beyond : float32, from that cell's corner
    """

    cell: Vector
    beyond: Vector


@dataclass(frozen=True)
class MixedWindow(Window):
    """Where the windows of rays begin in the domain, and in each of the volumes."""

    begins: tuple[Begin, ...] = ()


@dataclass(frozen=True)
class Spots(Spot):
    """Places of a packet in the domain, whose voxels are none, and in each of the volumes."""

    shares: tuple[RankWork, ...] = ()


class Body:
    """One volume, where rays are concerned.

    Parameters
    ----------
    job : the volume's own
    number : of the volume
    nearest : voxels are looked up, not cells
    ramped : slabs are classified between their ends: what of them lies in the volume has to be known

    Attributes
    ----------
    stride : of the rays that are taken now, from one midpoint to the next, in its voxels, float32
    """

    def __init__(self, code: Code, job: Job, number: int, nearest: bool, ramped: bool = False) -> None:
        self._code, self._job, self._number = code, job, number
        self._rows = [[job.part("index_from_domain", 4 * row + k) for k in range(4)] for row in range(3)]
        self._last = [job.part("last_cell", axis) + int(nearest) for axis in range(3)]
        self._from, self._to = (Variable(code.same(I32, 0)) for _ in range(2))
        self._stride = [Variable(code.same(F32, 0.0)) for _ in range(3)]
        self._parts = [Variable(code.same(F64, 0.0)) for _ in range(3)] if ramped else []

    @property
    def layout(self) -> Layout:
        """What is kept of a packet: the slabs whose midpoints lie in the volume, the stride, and what of rays does."""
        within: Layout = ((self._name("within"), F64, 2),) if self._parts else ()
        return (self._name("from"), I32, 1), (self._name("to"), I32, 1), (self._name("stride"), F32, 3), *within

    @property
    def stride(self) -> Vector:
        """See above."""
        x, y, z = (part.now for part in self._stride)
        return x, y, z

    def begin(self, packet: Packet, rays: Rays) -> None:
        """Write a packet's first state."""
        code, begin, end = self._code, self._code.same(I32, 0), rays.slabs
        for normal, offset in self._planes():
            first, past = kept_by(code, rays, normal, offset)
            begin, end = code.most(begin, first), code.least(end, past)
        packet.set(self._name("from"), begin)
        packet.set(self._name("to"), end)
        for side, at in enumerate(self._within(rays)):
            packet.set(self._name("within"), at, side)
        for axis, row in enumerate(self._rows):
            packet.set(self._name("stride"), side_of(self._normal(row), rays.slab).to(F32), axis)

    def take(self, packet: Packet, at: Value) -> None:
        """Rays are taken on from some slabs on, which are counted from there."""
        self._from.set(packet.get(self._name("from")) - at)
        self._to.set(packet.get(self._name("to")) - at)
        self._face(packet, at.to(F64))

    def enter(self, packet: Packet, rays: Rays) -> None:
        """The same of first slabs that the entry cuts: their midpoints are not on the lattice."""
        assert rays.entered is not None, "the lattice begins with the volume"
        assert rays.first_share is not None, "the lattice begins with the volume"
        inside = None
        for normal, offset in self._planes():
            here = side_of(normal, rays.entered) + offset >= 0.0
            inside = here if inside is None else inside & here
        assert inside is not None
        self._from.set(self._code.same(I32, 0))
        self._to.set(inside.to(I32))
        self._face(packet, 0.5 - 0.5 * rays.first_share.to(F64))

    def end(self, rays: Rays) -> None:
        """What are taken now are last slabs, which the exit may have cut."""
        if not self._parts:
            return
        # It lies so many slabs behind the first one, whose midpoint is on the lattice.
        way = [last - first for last, first in zip(rays.last, rays.first, strict=True)]
        square = side_of(rays.slab, rays.slab)
        self._parts[0].set(side_of(vector_of(way), rays.slab) / self._code.select(square > 0.0, square, 1.0))

    def part(self, number: Value, half: Value) -> tuple[Value, Value]:
        """What of slabs lies in the volume, float32, in slabs from their midpoints; where it ends first, nothing.

        Parameters
        ----------
        number : of the slabs, from those on that are taken now
        half : of their lengths, float32
        """
        middle, enter, leave = (part.now for part in self._parts)
        middle = middle + number.to(F64)
        return self._code.most((enter - middle).to(F32), -half), self._code.least((leave - middle).to(F32), half)

    def holds(self, number: Value) -> Value:
        """Whether slabs have their midpoint in the volume, by their numbers from those on that are taken now."""
        return (number >= self._from.now) & (number < self._to.now)

    def window(self, position: Vector, here: Value) -> Begin:
        """Where the windows of rays begin; anywhere for those that are not here."""
        code, whole, beyond = self._code, [], []
        for row in self._rows:
            at = side_of(self._normal(row), position) + row[3]
            floor = code.within(code.call("floor", at), -REACH, REACH)
            whole.append(code.select(here, floor, 0.0).to(I32))
            beyond.append(code.select(here, (at - floor).to(F32), 0.0))
        return Begin(vector_of(whole), vector_of(beyond))

    def share(self, brick: Value, begin: Begin, along: Value | None) -> RankWork:
        """Where slabs are in their bricks, as seen from the cell with which their window begins.

        Parameters
        ----------
        brick : the number of the brick in its box
        along : as `Spot.begin`
        """
        code, job = self._code, self._job
        *firsts, any_ = (part.bits(I32) for part in rows(code, job["firsts"], brick.to(I32), 4))
        local = [cell - first for cell, first in zip(begin.cell, firsts, strict=True)]
        # Rays that are farther away than a window is long are not there; where they read has to be somewhere.
        there, farthest = any_ > 0, job["farthest"]
        for part, last in zip(local, self._last, strict=True):
            there = there & (part >= -farthest) & (part <= last + farthest)
        local = [code.select(there, part, 0) for part in local]
        beyond = [code.select(there, part, 0.0) for part in begin.beyond]
        low = [(0 - part).to(F32) for part in local]
        high = [(last - part).to(F32) for part, last in zip(local, self._last, strict=True)]
        voxel = code.gather(job.word, job["bricks"], brick.to(I32), BYTES[job.word]) + self._voxel(local)
        return RankWork(Spot(voxel, vector_of(low), vector_of(high), vector_of(beyond), begin.cell, along), there)

    def _voxel(self, local: Sequence[Value]) -> Value:
        """The number of a cell's first corner in its brick, of the job's `word`."""
        x, y, z = (at - self._job["first_voxel"] for at in local)
        return (z * self._job["layer"] + y * self._job["row"] + x).to(self._job.word)

    def _face(self, packet: Packet, middle: Value) -> None:
        for axis, part in enumerate(self._stride):
            part.set(packet.get(self._name("stride"), axis))
        if self._parts:
            ends = (packet.get(self._name("within"), side) for side in (0, 1))
            for part, value in zip(self._parts, (middle, *ends), strict=True):
                part.set(value)

    def _within(self, rays: Rays) -> tuple[Value, ...]:
        """From where to where rays lie in the volume, in slabs, whose midpoints lie at whole numbers."""
        if not self._parts:
            return ()
        code, enter, leave = self._code, self._code.same(F64, -FAR), self._code.same(F64, FAR)
        for axis, row in enumerate(self._rows):
            extent, normal = self._job.part("extent", axis), self._normal(row)
            slack, at = SLACK * extent, side_of(normal, rays.first) + row[3]
            begin, end = between(code, at + slack, side_of(normal, rays.slab), code.splat(extent + 2.0 * slack))
            enter, leave = code.most(enter, begin), code.least(leave, end)
        return enter, leave

    def _name(self, what: str) -> str:
        return f"{what}_{self._number}"

    def _normal(self, row: Sequence[Value]) -> Vector:
        return vector_of([self._code.splat(part) for part in row[:3]])

    def _planes(self) -> list[tuple[Vector, Value]]:
        """The volume's faces, a little wider, as planes that keep what lies between them."""
        planes: list[tuple[Vector, Value]] = []
        for axis, row in enumerate(self._rows):
            extent, (x, y, z) = self._job.part("extent", axis), self._normal(row)
            slack = SLACK * extent
            planes.append(((x, y, z), self._code.splat(row[3] + slack)))
            planes.append(((-x, -y, -z), self._code.splat(extent + slack - row[3])))
        return planes


class Bodies:
    """The volumes of a mixture, where rays are concerned."""

    def __init__(self, bodies: Sequence[Body]) -> None:
        self._bodies = bodies

    @property
    def layout(self) -> Layout:
        """What is kept of a packet."""
        return tuple(part for body in self._bodies for part in body.layout)

    def begin(self, packet: Packet, rays: Rays) -> None:
        """Write a packet's first state."""
        for body in self._bodies:
            body.begin(packet, rays)

    def take(self, packet: Packet, at: Value) -> None:
        """Rays are taken on from some slabs on."""
        for body in self._bodies:
            body.take(packet, at)

    def enter(self, packet: Packet, rays: Rays) -> None:
        """First slabs are taken that the entry cuts."""
        for body in self._bodies:
            body.enter(packet, rays)

    def end(self, rays: Rays) -> None:
        """What are taken now are last slabs."""
        for body in self._bodies:
            body.end(rays)


class MixedPlaces(Places):
    """The bricks of a domain and their groups of cells; in place of voxels they tell bricks' numbers in the box."""

    def __init__(self, code: Code, job: Job, bodies: Sequence[Body]) -> None:
        super().__init__(code, job, False, Pitch(code, job))
        self._bodies = bodies

    def _voxels_of(self, brick: Value) -> Value:
        return brick.to(self._job.word)

    def window(self, position: Vector, here: Value) -> MixedWindow:
        """Of a midpoint, in the domain and in all volumes."""
        begins = tuple(body.window(position, here) for body in self._bodies)
        return MixedWindow(**vars(super().window(position, here)), begins=begins)

    def spot(self, place: Place, window: Window, along: Value | None = None) -> Spots:
        """Where slabs are in all volumes."""
        assert isinstance(window, MixedWindow), "windows of a mixture begin in all volumes"
        each = zip(self._bodies, window.begins, strict=True)
        shares = tuple(body.share(place.voxels, begin, along) for body, begin in each)
        return Spots(**vars(super().spot(place, window, along)), shares=shares)
