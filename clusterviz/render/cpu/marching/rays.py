"""Rays of a packet of pixels and their lattice of slabs: the twin of ray.glsl, in double precision."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from clusterviz.kernels.code import Code, Variable
from clusterviz.kernels.lanes import F32, F64, I32, Operand, Value, Vector
from clusterviz.render.cpu.job import Job

# As signed numbers.
FACTORS = (0x7FEB352D, 0x846CA68B - (1 << 32))
DIGITS = 24


def shift_of(code: Code, x: Value, y: Value) -> Value:
    """By what share of a slab, float64 in [0, 1), the first one begins before the volume, for pixels of the picture.

    References
    ----------
    C. Wellons: Prospecting for hash functions, 2018 (lowbias32).
    """
    return (_hashed(_hashed(x) + y) >> (32 - DIGITS)).to(F64) * code.same(F64, 2.0**-DIGITS)


def _hashed(x: Value) -> Value:
    assert x.element is I32, "the hash is one of 32 bits"
    x = (x ^ (x >> 16)) * FACTORS[0]
    x = (x ^ (x >> 15)) * FACTORS[1]
    return x ^ (x >> 16)


FAR = 1e300
MOST_SLABS = 2.0**31 - 2


@dataclass(frozen=True)
class Rays:
    """The rays of a packet, in index space: units are voxels along (x, y, z); parameters are world lengths.

    Attributes
    ----------
    first : midpoint of slab 0, float64
    slab : from one midpoint to the next, float64
    last : midpoint of the last slab, which the exit may have cut short
    slabs : how many; 0 where the ray misses the volume
    last_share : length of the last slab over that of a full one, float32
    entered : midpoint of slab 0 where the entry cuts it; None where lattices begin with the volume
    first_share : the length of what is left of it, likewise
    """

    first: Vector
    slab: Vector
    last: Vector
    slabs: Value
    last_share: Value
    entered: Vector | None = None
    first_share: Value | None = None


def packet_rays(code: Code, job: Job, x: Value, y: Value, jittered: bool = False) -> Rays:
    """The rays through the pixels (x, y) of the picture, int32.

    Parameters
    ----------
    jittered : every pixel has a lattice of its own
    """
    origin, direction = _through(code, job, x, y)
    entry, leave = code.same(F64, 0.0), code.same(F64, FAR)
    for axis in range(3):
        near, far = between(code, origin[axis], direction[axis], code.splat(job.part("extent", axis)))
        entry, leave = code.most(entry, near), code.least(leave, far)
    step = code.splat(job.part("extent", 3))
    length = (leave - entry) / step

    def at(slabs: Operand) -> Vector:
        end = entry + slabs * step
        x, y, z = (o + d * end for o, d in zip(origin, direction, strict=True))
        return x, y, z

    x_slab, y_slab, z_slab = (d * step for d in direction)
    slab = x_slab, y_slab, z_slab
    if jittered:
        shift = shift_of(code, x, y)
        slabs = _counted(code, code.select(length > 0.0, length + shift, 0.0))
        before_last = code.select(slabs > 1.0, slabs - 1.0 - shift, 0.0)
        first, entered, first_share = at(0.5 - shift), at(0.5 * (1.0 - shift)), (1.0 - shift).to(F32)
    else:
        slabs = _counted(code, length)
        before_last, first, entered, first_share = slabs - 1.0, at(0.5), None, None
    share = length - before_last
    last = at(before_last + 0.5 * share)
    return Rays(first, slab, last, slabs.to(I32), share.to(F32), entered, first_share)


def _counted(code: Code, length: Value) -> Value:
    """How many slabs a length takes."""
    return code.within(code.call("ceil", length), 0.0, MOST_SLABS)


def _through(code: Code, job: Job, x: Value, y: Value) -> tuple[list[Value], list[Value]]:
    """Where the rays of pixels come from, and their directions, by axis."""
    pixel, half_width, half_height = (code.splat(job.part("lens", k)) for k in range(3))
    across = (x.to(F64) + 0.5 - half_width) * pixel
    above = (half_height - y.to(F64) - 0.5) * pixel
    parallel = ~job.part("lens", 3).equals(0.0)
    scale = code.call("sqrt", 1.0 + across * across + above * above)
    origin, direction = [], []
    for axis in range(3):
        eye, right, up, forward = (code.splat(job.part(name, axis)) for name in ("eye", "right", "up", "forward"))
        aside = across * right + above * up
        mask = code.splat(parallel)
        origin.append(code.select(mask, eye + aside, eye))
        direction.append(code.select(mask, forward, (forward + aside) / scale))
    return origin, direction


def between(code: Code, origin: Value, direction: Value, high: Value) -> tuple[Value, Value]:
    """Where rays are between two planes; one that is parallel to them is so always or never."""
    still = direction.equals(0.0)
    safe = code.select(still, 1.0, direction)
    a, b = (0.0 - origin) / safe, (high - origin) / safe
    inside = (origin >= 0.0) & (origin <= high)
    always = code.select(inside, code.same(F64, -FAR), code.same(F64, FAR))
    return code.select(still, always, code.least(a, b)), code.select(still, -always, code.most(a, b))


def midpoint(code: Code, rays: Rays, slab: Value) -> Vector:
    """The midpoint of a slab of each ray, not of the last: the expression by which every box decides what it owns."""
    number = slab.to(F64)
    x, y, z = (code.fma(number, by, at) for by, at in zip(rays.slab, rays.first, strict=True))
    return x, y, z


def cell_of(code: Code, job: Job, position: Vector) -> Vector:
    """The cell that holds a midpoint, int32; rounding may put one on the far faces, which belong to the last cells."""
    cells = []
    for axis, at in enumerate(position):
        last = job.part("cells", axis) - 1
        cells.append(code.least(code.most(code.within(at, -1.0, 2.0**31 - 1).to(I32), 0), last))
    x, y, z = cells
    return x, y, z


def owned(job: Job, cell: Vector) -> Value:
    """Whether the box of the draw holds a cell."""
    inside = None
    for axis, at in enumerate(cell):
        here = (at >= job.part("box_begin", axis)) & (at < job.part("box_end", axis))
        inside = here if inside is None else inside & here
    assert inside is not None
    return inside


def owned_range(code: Code, job: Job, rays: Rays, end: Value) -> tuple[Value, Value]:
    """The slabs [first, behind) below `end` that the box owns: midpoints run one way along each axis."""
    enter, leave = code.same(F64, 0.0), end.to(F64)
    for axis in range(3):
        by, at = rays.slab[axis], rays.first[axis]
        low, high = (code.splat(job.part(name, axis).to(F64)) for name in ("box_begin", "box_end"))
        still = by.equals(0.0)
        safe = code.select(still, 1.0, by)
        near, far = ((face - at) / safe for face in (low, high))
        enter = code.select(still, enter, code.most(enter, code.least(near, far)))
        leave = code.select(still, leave, code.least(leave, code.most(near, far)))
    begin = _first(code, rays, enter, end, lambda position: ~_before_or_behind(code, job, rays, position)[0])
    behind = _first(code, rays, leave, end, lambda position: _before_or_behind(code, job, rays, position)[1])
    return begin, code.most(begin, behind)


def _before_or_behind(code: Code, job: Job, rays: Rays, position: Vector) -> tuple[Value, Value]:
    """Whether midpoints lie in front of a face of the box by which rays come in, and behind one by which they leave."""
    before = behind = None
    for axis, at in enumerate(cell_of(code, job, position)):
        low, high, rises = at < job.part("box_begin", axis), at >= job.part("box_end", axis), rays.slab[axis] >= 0.0
        first, last = code.select(rises, low, high), code.select(rises, high, low)
        before = first if before is None else before | first
        behind = last if behind is None else behind | last
    assert before is not None
    assert behind is not None
    return before, behind


def _first(code: Code, rays: Rays, guess: Value, end: Value, holds: Callable[[Vector], Value]) -> Value:
    """The first slab below `end` from which on something holds of midpoints, else `end`.

    The guess is nearly always within two of it; where midpoints are closer than rounding, as those of rays that all but
    run along a face, it may be anywhere.
    """
    near = code.within(guess, 0.0, end.to(F64)).to(I32)
    low, high = Variable(near - 2), Variable(code.least(near + 2, end))
    below = code.most(low.now, 0)
    low.set(code.select((low.now < 0) | holds(midpoint(code, rays, below)), -1, low.now))
    high.set(code.select((high.now < end) & ~holds(midpoint(code, rays, high.now)), end, high.now))
    with code.loop(lambda: code.any(high.now - low.now > 1)):
        middle = (low.now + high.now).shifted(1)
        found = holds(midpoint(code, rays, code.most(middle, 0)))
        # Where nothing is left to halve, the middle is `low`.
        high.set(code.select(found & (middle > low.now), middle, high.now))
        low.set(code.select(found, low.now, middle))
    return high.now
