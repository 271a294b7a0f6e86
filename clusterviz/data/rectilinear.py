"""Samples at uneven coordinates along each axis, as a volume on an even lattice that is computed when boxes are read.

Between its samples a rectilinear grid is trilinear. So it is the same function on any finer lattice that holds all of
its coordinates, and nothing else has to know about coordinates. The lattice's step is a whole part of the smallest
distance. Where there is no such lattice, coordinates are moved to one by at most 1 % of the smallest distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.derived import DerivedSource
from clusterviz.data.header import check_box, make_grid
from clusterviz.data.source import Grid, Index, as_index
from clusterviz.errors import DataError

MAX_STEPS = 1 << 20
"""Steps of the lattice along an axis."""
MAX_UNEVENNESS = 0.01
"""Of a step, by which coordinates may lie off the lattice; float32 and Gaussian latitudes are slightly uneven."""
MAX_PARTS = 64
"""Steps of the lattice in the smallest distance; from 50 on half a step is less than 1 % of that distance."""
MAX_GROWTH, FEW_SAMPLES = 64, 1 << 27
"""Samples of the lattice for each that is stored, and how many may be in any case."""


@dataclass(frozen=True)
class Line:
    """Axis of a lattice, and the samples of it that are stored.

    Attributes
    ----------
    first, step : coordinates of the lattice
    places : int64, ascending; the lattice's samples that are stored
    """

    first: float
    step: float
    places: NDArray[np.int64]


def even_line(count: int, first: float = 0.0, step: float = 1.0) -> Line:
    return Line(first, step, np.arange(count, dtype=np.int64))


def line_of(coordinates: NDArray[Any], spaced: bool, name: str, where: str) -> Line:
    """Return the coarsest lattice that holds the coordinates of an axis, or else one that nearly does.

    Parameters
    ----------
    coordinates : (n,), at least one; how far the numbers of their type lie apart is no unevenness
    spaced : the spacing is given elsewhere, so impossible coordinates count as even
    name : of the axis, for messages
    """
    numbers, rounding = np.asarray(coordinates, np.float64), _rounding(coordinates)
    first, count = float(numbers[0]), len(numbers)
    if count < 2:
        return even_line(count, first)
    step = float(numbers[-1] - first) / (count - 1)
    even = even_line(count, first, step)
    if (np.abs(numbers - first - step * np.arange(count)) <= MAX_UNEVENNESS * abs(step) + rounding).all():
        return even
    gaps = np.diff(numbers) * np.sign(step)
    if not (np.isfinite(numbers).all() and (gaps > 0).all()):
        if spaced:
            return even
        allowed = "numbers that ascend or descend"
        raise DataError(f"impossible coordinates {name}", where=where, found=numbers[:8].tolist(), allowed=allowed)
    first_of_all, mean = _straight(numbers, float(gaps.min()) * np.sign(step), float(gaps.max()) * np.sign(step))
    if (np.abs(numbers - first_of_all - mean * np.arange(count)) <= MAX_UNEVENNESS * abs(mean) + rounding / 2).all():
        return even_line(count, first_of_all, mean)
    whole, gap = float(numbers[-1] - first), float(gaps.min())
    steps = abs(whole) / gap
    for exact, parts in product((True, False), range(1, MAX_PARTS + 1) if steps <= MAX_STEPS else ()):
        steps = round(abs(whole) / gap * parts)
        places = np.rint((numbers - first) / (whole / steps)).astype(np.int64)
        away = np.abs(numbers - first - whole / steps * places).max()
        if away <= MAX_UNEVENNESS * (abs(whole) / steps if exact else gap) + rounding:
            break
    if steps <= MAX_STEPS:
        return Line(first, whole / steps, places)
    if spaced:
        return even
    allowed = f"at most {MAX_STEPS} steps; or spacing: [x, y, z] of the volume"
    raise DataError(f"the coordinates {name} need too fine a lattice", where=where, found=f"{steps:g}", allowed=allowed)


def _rounding(coordinates: NDArray[Any]) -> float:
    """Return the distance of neighbouring numbers of the coordinates' type where they are largest; 0 for integers."""
    stored = np.asarray(coordinates)
    if stored.dtype.kind != "f" or not np.isfinite(stored).all():
        return 0.0
    return float(np.spacing(np.abs(stored).max().astype(stored.dtype.newbyteorder("="))))


def _straight(numbers: NDArray[np.float64], low: float, high: float) -> tuple[float, float]:
    """Return the even coordinates, first and step, whose largest distance from `numbers` is least.

    The distance is a convex function of the step, which lies between `low` and `high`.
    """
    places = np.arange(len(numbers))
    for _ in range(64):
        one, other = (2 * low + high) / 3, (low + 2 * high) / 3
        low, high = (low, other) if np.ptp(numbers - one * places) <= np.ptp(numbers - other * places) else (one, high)
    rest = numbers - low * places
    return float(rest.max() + rest.min()) / 2, low


@dataclass(frozen=True)
class RectilinearSource(DerivedSource):
    """Volume on a lattice, of another one whose samples lie at some of its places.

    Attributes
    ----------
    grid : of the lattice
    places_zyx : for each axis, the places of the stored samples
    """

    grid: Grid
    places_zyx: tuple[NDArray[np.int64], ...]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Float32, or float64 if float32 cannot hold the stored type."""
        return np.result_type(self.source.dtype, np.float32)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        if 0 in shape:
            return np.empty(shape, self.dtype)
        below, weights, begin, end = [], [], [], []
        for places, first, last in zip(self.places_zyx, begin_zyx, end_zyx, strict=True):
            wanted = np.arange(first, last)
            before = np.searchsorted(places, wanted, "right") - 1
            after = np.minimum(before + 1, len(places) - 1)
            weights.append((wanted - places[before]) / np.maximum(places[after] - places[before], 1))
            begin.append(int(before[0]))
            end.append(int(before[-1]) + (2 if weights[-1][-1] else 1))
            below.append(before - begin[-1])
        stored: NDArray[Any] = self.source.read(as_index(begin), as_index(end)).astype(self.dtype)
        for axis in range(3):
            stored = interpolate(stored, below[axis], weights[axis], axis)
        return np.ascontiguousarray(stored, self.dtype)


def interpolate(
    samples: NDArray[Any], below: NDArray[np.int64], weights: NDArray[np.float64], axis: int
) -> NDArray[Any]:
    """Return samples between neighbours along an axis: (1 − weight) of `below`, and weight of the next one.

    Where the weight is 0 the sample itself is returned, whatever its neighbour is.
    """
    low = samples.take(below, axis)
    if not weights.any():
        return low
    shape = [1, 1, 1]
    shape[axis] = len(weights)
    weight = weights.astype(samples.dtype).reshape(shape)
    high = samples.take(np.minimum(below + 1, samples.shape[axis] - 1), axis)
    with np.errstate(all="ignore"):
        low *= 1 - weight
        high *= weight
        high.swapaxes(0, axis)[weights == 0] = 0
        low += high
    return low


def placed(source: Any, lines_xyz: Sequence[Line], axes: NDArray[np.float64], spaced: bool) -> Any:
    """Return a volume at the coordinates of three lines.

    Parameters
    ----------
    source : the stored samples, a source that is a dataclass with a field `grid`, which is replaced
    axes : float64 (3, 3); column a is the unit vector of the coordinates along index axis a (x, y, z) in the world
    spaced : the spacing is given elsewhere, so coordinates count as even if their lattice is too fine
    """
    stored, shape = [len(line.places) for line in lines_xyz], [int(line.places[-1]) + 1 for line in lines_xyz]
    if prod(shape) > max(MAX_GROWTH * prod(stored), FEW_SAMPLES):
        if spaced:
            wholes = [line.step * float(line.places[-1]) for line in lines_xyz]
            steps = [whole / max(1, n - 1) or 1.0 for whole, n in zip(wholes, stored, strict=True)]
            lines = [even_line(n, line.first, step) for n, line, step in zip(stored, lines_xyz, steps, strict=True)]
            return placed(source, lines, axes, False)
        found = f"{' x '.join(map(str, shape))} steps for {' x '.join(map(str, stored))} samples"
        allowed = f"at most {MAX_GROWTH} times as many, or {FEW_SAMPLES} in all; or spacing: [x, y, z] of the volume"
        raise DataError("the coordinates need too fine a lattice", where=source.name, found=found, allowed=allowed)
    x, y, z = shape
    origin = axes @ np.array([line.first for line in lines_xyz])
    steps_xyz = axes * np.array([line.step for line in lines_xyz]) + 0.0  # no −0
    grid = make_grid((z, y, x), steps_xyz, origin, source.name)
    if shape == stored:
        return replace(source, grid=grid)
    return RectilinearSource(source, grid, tuple(line.places for line in reversed(lines_xyz)))
