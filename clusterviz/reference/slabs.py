"""Reference slabs: the segments into which rays are cut, and their sample positions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clusterviz.reference.rays import Columns, Floats, Rays, inside


@dataclass(frozen=True)
class Slab(Columns):
    """The k-th slab of rays."""

    rays: NDArray[np.int64]  # int (m,), indices of the rays
    # float64 (m,), world lengths along the ray
    begin: Floats
    end: Floats
    point: Floats  # float64 (m, 3), (x, y, z) of the midpoint in the rays' space: for one volume, in samples


def slabs(
    rays: Rays, shape_zyx: tuple[int, ...], length: float, goes_on: Callable[[], NDArray[np.bool_] | bool]
) -> Iterator[Slab]:
    """Yield slab after slab of all rays that are still inside the volume.

    `rays`: rays in index space. `shape_zyx`: samples of the volume. `length`: length of the longest slabs, world units.
    `goes_on`: called before each slab; returns the rays that continue, bool (n,) or one for all.
    """
    yield from slabs_in(rays, np.array(shape_zyx[::-1], np.float64) - 1, length, goes_on)


def slabs_in(
    rays: Rays, last: Floats, length: float, goes_on: Callable[[], NDArray[np.bool_] | bool]
) -> Iterator[Slab]:
    """Yield the slabs in the box [0, last], (x, y, z) in the rays' own units."""
    entry, leave = inside(rays, last)
    own = np.broadcast_to(rays.thickness * length, entry.shape)
    first = entry - rays.shift * own
    alive, k = np.flatnonzero(leave > entry), 0
    while alive.size:
        begin = np.maximum(first[alive] + k * own[alive], entry[alive])
        end = np.minimum(first[alive] + (k + 1) * own[alive], leave[alive])
        point = rays.start[alive] + (begin + (end - begin) / 2)[:, None] * rays.direction[alive]
        yield Slab(alive, begin, end, point)
        k += 1
        wanted = np.ones(len(entry), bool) & goes_on()
        alive = alive[(first[alive] + k * own[alive] < leave[alive]) & wanted[alive]]


def pieces_of(slab: Slab, rays: Rays, shape_zyx: tuple[int, ...], brick: int | None) -> Iterator[Slab]:
    """Yield the parts of a slab between the faces of bricks, front to back, some empty; without bricks the slab.

    `brick`: cells along the side of a brick, at least the slab's length.
    """
    if brick is None:
        yield slab
        return
    start, direction = rays.start[slab.rays], rays.direction[slab.rays]
    cuts = [slab.begin, slab.end]
    for axis, samples in enumerate(shape_zyx[::-1]):
        at, by = start[:, axis], direction[:, axis]
        first = np.floor(np.minimum(at + slab.begin * by, at + slab.end * by) / brick) + 1
        for face in (first, first + 1):
            with np.errstate(divide="ignore", invalid="ignore"):
                met = (face * brick - at) / by
            # Slabs are not cut at the faces of the volume.
            cuts.append(np.where((by != 0) & (face > 0) & (face * brick < samples - 1), met, slab.begin))
    ordered = np.sort(np.clip(cuts, slab.begin, slab.end), axis=0)
    for begin, end in pairwise(ordered):
        yield Slab(slab.rays, begin, end, start + (begin + (end - begin) / 2)[:, None] * direction)


def in_brick(point: Floats, beside: Floats, brick: int | None) -> Floats:
    """Return points, float64 (m, 3), moved by at most rounding into the bricks of other points."""
    if brick is None:
        return point
    first = np.floor(beside / brick) * brick
    return np.clip(point, first, np.nextafter(first + brick, first))
