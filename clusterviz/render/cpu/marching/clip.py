"""Which slabs of rays clipping planes keep: those whose midpoint lies on the near side of all; twin of clip.glsl."""

from __future__ import annotations

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F64, I32, I64, Value, Vector
from clusterviz.render.cpu.job import Job
from clusterviz.render.cpu.marching.rays import Rays

PLANE_BYTES = 32


def kept_range(code: Code, job: Job, rays: Rays) -> tuple[Value, Value]:
    """The slabs [begin, end) that all planes keep, int32: midpoints lie in order along a ray, so they are a range."""
    begin, end = Variable(code.same(I32, 0)), Variable(rays.slabs)
    number = Variable(code.number(I64, 0))
    with code.loop(lambda: number.now < job["planes"].to(I64)):
        first, past = kept_by(code, rays, *_plane(code, job, number.now))
        begin.set(code.most(begin.now, first))
        end.set(code.least(end.now, past))
        number.set(number.now + 1)
    return begin.now, end.now


def keeps(code: Code, job: Job, place: Vector) -> Value:
    """Whether all planes keep places."""
    kept, number = Variable(code.same(I32, 1)), Variable(code.number(I64, 0))
    with code.loop(lambda: number.now < job["planes"].to(I64)):
        normal, offset = _plane(code, job, number.now)
        kept.set(code.select(side_of(normal, place) + offset >= 0.0, kept.now, 0))
        number.set(number.now + 1)
    return kept.now > 0


class Cut:
    """Which midpoints of the slabs that a packet's rays take now all planes keep, where slabs are not taken as wholes.

    Surfaces are cut where they are: a slab is taken if any part of it may be kept, which is one more at either end.
    """

    def __init__(self, code: Code) -> None:
        self._code = code
        self._from, self._to = (Variable(code.same(I32, 0)) for _ in range(2))

    def take(self, begin: Value, end: Value) -> None:
        """Tell the slabs [begin, end) that planes keep, by their numbers from those on that are taken now."""
        self._from.set(begin)
        self._to.set(end)

    def keeps(self, number: Value) -> Value:
        """Whether the midpoint of a slab is kept, by its number from those on that are taken now."""
        return (number >= self._from.now) & (number < self._to.now)


def _plane(code: Code, job: Job, number: Value) -> tuple[Vector, Value]:
    address = job["clip"] + number * PLANE_BYTES
    x, y, z, w = (code.splat(code.load(F64, address + 8 * part)) for part in range(4))
    return (x, y, z), w


def side_of(normal: Vector, place: Vector) -> Value:
    """The inner product of a plane's normal and places: with the offset, on which side they lie."""
    x, y, z = (by * at for by, at in zip(normal, place, strict=True))
    return x + y + z


def kept_by(code: Code, rays: Rays, normal: Vector, offset: Value) -> tuple[Value, Value]:
    """The same for one plane. The estimates are within one of the truth; the test is exact."""
    whole = code.most(rays.slabs - 1, 0)
    at, by = side_of(normal, rays.first) + offset, side_of(normal, rays.slab)
    rises, falls = by > 0.0, by < 0.0
    ratio = (0.0 - at) / code.select(rises | falls, by, 1.0)
    first = code.within(code.call("ceil", ratio), 0.0, whole.to(F64)).to(I32)
    past = code.within(code.call("floor", ratio) + 1.0, 0.0, whole.to(F64)).to(I32)
    never = ~rises & ~falls & (at < 0.0)
    kept_to = code.select(falls, _past_kept(code, at, by, past, whole), code.select(never, 0, whole))
    # The last slab's midpoint is not on the lattice.
    kept_to = code.select(kept_to.equals(whole) & (side_of(normal, rays.last) + offset >= 0.0), rays.slabs, kept_to)
    return code.select(rises, _first_kept(code, at, by, first, whole), 0), kept_to


def _is_kept(code: Code, at: Value, by: Value, slab: Value) -> Value:
    return code.fma(slab.to(F64), by, at) >= 0.0


def _first_kept(code: Code, at: Value, by: Value, begin: Value, whole: Value) -> Value:
    earlier = (begin > 0) & _is_kept(code, at, by, begin - 1)
    later = (begin < whole) & ~_is_kept(code, at, by, begin)
    return code.select(earlier, begin - 1, code.select(later, begin + 1, begin))


def _past_kept(code: Code, at: Value, by: Value, end: Value, whole: Value) -> Value:
    later = (end < whole) & _is_kept(code, at, by, end)
    earlier = (end > 0) & ~_is_kept(code, at, by, end - 1)
    return code.select(later, end + 1, code.select(earlier, end - 1, end))
