"""The witness's slabs: the pieces into which every ray is cut, and where each is sampled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

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
