"""The witness's slabs: the pieces into which every ray is cut, and where each is sampled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clusterviz.reference.rays import Floats, Rays, inside


@dataclass(frozen=True)
class Slab:
    """The k-th slab of some rays.

    Attributes
    ----------
    rays : int (m,), which of the rays
    begin, end : float64 (m,), from where to where, world lengths along the ray
    point : float64 (m, 3), (x, y, z) of its midpoint in the rays' space: for one volume, in samples
    """

    rays: NDArray[np.int64]
    begin: Floats
    end: Floats
    point: Floats


def slabs(
    rays: Rays, shape_zyx: tuple[int, ...], length: float, goes_on: Callable[[], NDArray[np.bool_] | bool]
) -> Iterator[Slab]:
    """Slab after slab, for all rays that are still inside the volume.

    Parameters
    ----------
    rays : in index space
    shape_zyx : samples of the volume
    length : of a slab, world units
    goes_on : asked before each slab; the rays that still want one, bool (n,) or one for all
    """
    yield from slabs_in(rays, np.array(shape_zyx[::-1], np.float64) - 1, length, goes_on)


def slabs_in(
    rays: Rays, last: Floats, length: float, goes_on: Callable[[], NDArray[np.bool_] | bool]
) -> Iterator[Slab]:
    """The same in the box [0, last], (x, y, z) in the rays' own units."""
    entry, leave = inside(rays, last)
    first = entry - rays.shift * length
    alive, k = np.flatnonzero(leave > entry), 0
    while alive.size:
        begin = np.maximum(first[alive] + k * length, entry[alive])
        end = np.minimum(first[alive] + (k + 1) * length, leave[alive])
        point = rays.start[alive] + (begin + (end - begin) / 2)[:, None] * rays.direction[alive]
        yield Slab(alive, begin, end, point)
        k += 1
        wanted = np.ones(len(entry), bool) & goes_on()
        alive = alive[(first[alive] + k * length < leave[alive]) & wanted[alive]]


def pieces_of(slab: Slab, rays: Rays, shape_zyx: tuple[int, ...], brick: int | None) -> Iterator[Slab]:
    """The parts of a slab between the faces of bricks, from front to back, some of no length; without bricks the slab.

    Parameters
    ----------
    brick : cells along the side of a brick, no less than the slab's length
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
            # The volume's own faces cut nothing.
            cuts.append(np.where((by != 0) & (face > 0) & (face * brick < samples - 1), met, slab.begin))
    ordered = np.sort(np.clip(cuts, slab.begin, slab.end), axis=0)
    for begin, end in pairwise(ordered):
        yield Slab(slab.rays, begin, end, start + (begin + (end - begin) / 2)[:, None] * direction)


def in_brick(point: Floats, beside: Floats, brick: int | None) -> Floats:
    """Points, float64 (m, 3), moved by rounding's worth into the bricks of others, [first cell, first of the next)."""
    if brick is None:
        return point
    first = np.floor(beside / brick) * brick
    return np.clip(point, first, np.nextafter(first + brick, first))
