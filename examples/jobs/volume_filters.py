"""Filters of whole volumes: gradient, smoothing and up-sampling, as kernels over boxes of voxels.

A filter says which voxels a box of its result needs, and computes the box from them. So `apply_filter` runs it on the
blocks of a distributed array, and `FilteredSource` on whatever box a reader asks for; both give the same bits, as no
value depends on the box in which it is computed. Voxels are taken as float32. Those that are NaN, infinite or larger
than 3e38 are invalid, and have no influence on others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import Box
from clusterviz.data.header import check_box
from clusterviz.data.source import Grid, Index, Source, Triple
from clusterviz.errors import InputError
from clusterviz.jobs.array import DistributedArray
from clusterviz.jobs.cluster import Cluster
from clusterviz.jobs.job import job
from clusterviz.jobs.kernel import kernel

Floats = NDArray[np.float32]
Pair = tuple[int, int]
LARGEST = 3e38
"""Magnitude beyond which a voxel counts as invalid, as in the renderer."""
REACH = 4
"""Standard deviations after which a Gaussian is cut off."""
MOST_REACH = 256
"""Voxels beside a voxel that smoothing reads, at most."""


class Filter(Protocol):
    """Filter of a volume.

    Attributes
    ----------
    components : numbers of a voxel of the result; 1: the result has no axis for them
    """

    @property
    def components(self) -> int: ...

    def result_grid(self, grid: Grid) -> Grid:
        """Return the grid of the result for the grid of a volume."""
        ...

    def reads(self, box: Box, shape_zyx: Index) -> Box:
        """Return the box of a volume of this shape that a box of the result needs."""
        ...

    def __call__(self, voxels: Floats, read: Box, box: Box, grid: Grid) -> Floats:
        """Return a box of the result.

        Parameters
        ----------
        voxels : float32 (z, y, x), of the box that `reads` names
        read : that box
        box : of the result
        grid : of the volume

        Returns
        -------
        found : float32 (z, y, x), or (z, y, x, components)
        """
        ...


@kernel("numbers.glsl", "central_differences.glsl", writes=("gradient",), vectors=("gradient",))
def central_differences(
    volume: Floats, gradient: Floats, first: Index, world_x: Triple, world_y: Triple, world_z: Triple
) -> None:
    """Compute gradients (x, y, z) in the world and their magnitudes; `first`: voxel of the first gradient."""


@kernel("convolve.glsl", writes=("sums", "totals"))
def convolve(
    values: Floats, valid: Floats, weights: Floats, sums: Floats, totals: Floats, first: Index, axis: Index
) -> None:
    """Convolve along one axis; `values` are 0 where `valid` is; `first`: voxel of the first sum."""


@kernel("numbers.glsl", "upsample.glsl", writes=("found",))
def upsample(
    volume: Floats, weights: Floats, found: Floats, first: Index, corner: Index, last: Index, taps: Pair, factor: int
) -> None:
    """Interpolate between voxels; `first`: the first sample in the result, `corner`: the first voxel in the volume."""


@dataclass(frozen=True)
class Gradient:
    """Gradient in the world, per world unit, and its magnitude: float32 (z, y, x, 4).

    It is that of the renderer's lighting at voxels: central differences; beside invalid voxels and at the border the
    derivative of a parabola through three voxels. NaN at invalid voxels.
    """

    components: ClassVar[int] = 4

    def result_grid(self, grid: Grid) -> Grid:
        return grid

    def reads(self, box: Box, shape_zyx: Index) -> Box:
        return _grown(box, (2, 2, 2), shape_zyx)

    def __call__(self, voxels: Floats, read: Box, box: Box, grid: Grid) -> Floats:
        found = np.empty((*_shape(box), 4), np.float32)
        world = np.linalg.inv(grid.world_from_index[:3, :3]).T
        central_differences[_shape(box)](voxels, found, _offset(box, read), *(tuple(map(float, row)) for row in world))
        return found


@dataclass(frozen=True)
class Smooth:
    """Mean of the valid voxels around each valid one, weighted by a kernel along each axis.

    Invalid voxels stay NaN, and weights are divided by their sum over the valid voxels, at the border too. So a
    constant volume stays constant up to rounding, and nothing is drawn towards what is missing.

    Attributes
    ----------
    size : of a Gaussian, its standard deviation in voxels; of a box, its half width: 2 · size + 1 voxels a side
    kind : "gaussian" (cut off at four standard deviations) or "box"

    Raises
    ------
    InputError
        Impossible size, or no such kind.
    """

    size: float = 1.0
    kind: str = "gaussian"
    components: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if self.kind not in ("gaussian", "box"):
            raise InputError("no such kernel", where="Smooth.kind", found=self.kind, allowed="gaussian, box")
        is_whole = self.kind == "gaussian" or float(self.size).is_integer()
        if not (0 < self.size <= MOST_REACH / (REACH if self.kind == "gaussian" else 1)) or not is_whole:
            numbers = f"numbers up to {MOST_REACH // REACH}" if self.kind == "gaussian" else f"1, 2, … {MOST_REACH}"
            raise InputError("impossible size", where="Smooth.size", found=self.size, allowed=numbers)

    @property
    def weights(self) -> Floats:
        """float32 (k + 1,): weights of a voxel and of those 1, …, k beside it."""
        if self.kind == "box":
            return np.ones(int(self.size) + 1, np.float32)
        apart = np.arange(math.ceil(REACH * self.size) + 1)
        return np.exp(-0.5 * (apart / self.size) ** 2).astype(np.float32)

    def result_grid(self, grid: Grid) -> Grid:
        return grid

    def reads(self, box: Box, shape_zyx: Index) -> Box:
        return _grown(box, (len(self.weights) - 1,) * 3, shape_zyx)

    def __call__(self, voxels: Floats, read: Box, box: Box, grid: Grid) -> Floats:
        valid = np.abs(voxels) <= LARGEST
        values, known = np.where(valid, voxels, np.float32(0)), valid.astype(np.float32)
        weights = self.weights / (2 * self.weights.sum() - self.weights[0])
        begin, end = read
        for axis in range(3):  # z, y, x: each pass leaves the halo of its axis
            part = [(box if a <= axis else read) for a in range(3)]
            now = _box(tuple(p[0][a] for a, p in enumerate(part)), tuple(p[1][a] for a, p in enumerate(part)))
            sums, totals = np.empty(_shape(now), np.float32), np.empty(_shape(now), np.float32)
            along = tuple(int(a == axis) for a in (2, 1, 0))
            convolve[_shape(now)](values, known, weights[None, None], sums, totals, _offset(now, (begin, end)), along)
            values, known, (begin, end) = sums, totals, now
        inside = valid[tuple(slice(b - r, e - r) for b, e, r in zip(*box, read[0], strict=True))]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(inside, values / known, np.float32(np.nan))


@dataclass(frozen=True)
class Upsample:
    """Volume with `factor` times as many cells along each axis, in the same box of the world.

    Attributes
    ----------
    factor : at least 1
    kind : "linear", or "cubic": B-splines with the voxels as coefficients, which smooth, as `interpolation: cubic`

    Raises
    ------
    InputError
        Impossible factor, or no such kind.
    """

    factor: int = 2
    kind: str = "linear"
    components: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if self.kind not in ("linear", "cubic"):
            raise InputError("no such interpolation", where="Upsample.kind", found=self.kind, allowed="linear, cubic")
        if not isinstance(self.factor, int) or not 1 <= self.factor <= 64:
            allowed = "a whole number, 1 to 64"
            raise InputError("impossible factor", where="Upsample.factor", found=self.factor, allowed=allowed)

    @property
    def weights(self) -> Floats:
        """float32 (1, factor, 4): weights of the four taps at each position in a cell."""
        t = np.arange(self.factor) / self.factor
        u = 1 - t
        rows = [u**3, 4 + 3 * t * t * (t - 2), 4 + 3 * u * u * (u - 2), t**3]
        rows = [row / 6 for row in rows] if self.kind == "cubic" else [0 * t, u, t, 0 * t]
        return np.stack(rows, axis=1)[None].astype(np.float32)

    def result_grid(self, grid: Grid) -> Grid:
        z, y, x = ((side - 1) * self.factor + 1 for side in grid.shape_zyx)
        dx, dy, dz = (length / self.factor for length in grid.spacing)
        return replace(grid, shape_zyx=(z, y, x), spacing=(dx, dy, dz))

    def reads(self, box: Box, shape_zyx: Index) -> Box:
        begin, end = (tuple(n // self.factor for n in box[0]), tuple((n - 1) // self.factor + 2 for n in box[1]))
        return _grown(_box(begin, end), (1, 1, 1), shape_zyx)

    def __call__(self, voxels: Floats, read: Box, box: Box, grid: Grid) -> Floats:
        found = np.empty(_shape(box), np.float32)
        last = tuple(n - 1 for n in grid.shape_zyx[::-1])
        taps = (0, 4) if self.kind == "cubic" else (1, 3)
        upsample[_shape(box)](voxels, self.weights, found, box[0][::-1], read[0][::-1], last, taps, self.factor)
        return found


@dataclass(frozen=True)
class FilteredSource:
    """Volume that is another one after a filter, computed box by box as it is read; see `Source`.

    Parameters
    ----------
    source : the volume
    filter : with one component, or `Gradient`, of which the magnitudes are the volume
    """

    source: Source
    filter: Filter
    dtype: np.dtype[Any] = field(default=np.dtype(np.float32), init=False)

    @property
    def name(self) -> str:
        return f"{self.source.name} ({type(self.filter).__name__.lower()})"

    @property
    def grid(self) -> Grid:
        return self.filter.result_grid(self.source.grid)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Compute the samples of a box; see `Source.read`."""
        check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        box, grid = (begin_zyx, end_zyx), self.source.grid
        read = self.filter.reads(box, grid.shape_zyx)
        found = self.filter(_as_float32(self.source.read(*read)), read, box, grid)
        return np.ascontiguousarray(found[..., -1]) if self.filter.components > 1 else found


def apply_filter(
    cluster: Cluster, volume: DistributedArray, filter: Filter, grid: Grid | None = None
) -> DistributedArray:
    """Filter a distributed array by blocks; collective.

    Parameters
    ----------
    volume : (z, y, x), any integer or float type
    grid : of the volume, for gradients in its world; by default voxels are 1 apart

    Returns
    -------
    found : float32, as many blocks along each axis as the volume has
    """
    given = grid or Grid(volume.shape_zyx)
    shape = filter.result_grid(given).shape_zyx
    found = cluster.array(
        shape if filter.components == 1 else (*shape, filter.components), np.float32, volume.grid.block_zyx
    )

    @job(reads=lambda index: (volume, filter.reads(found.box(index), volume.shape_zyx)))
    def run(index: Index) -> None:
        box = found.box(index)
        read = filter.reads(box, volume.shape_zyx)
        found.write(box, filter(_as_float32(volume.read(read)), read, box, given))

    cluster.run(run, found.blocks)
    found.sync()
    return found


def _as_float32(voxels: NDArray[Any]) -> Floats:
    """Return voxels as float32; what is too large for it becomes infinite, and so invalid."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(voxels, np.float32)


def _grown(box: Box, halo: Index, shape_zyx: Index) -> Box:
    """Return a box with a halo on all sides, cut at the volume."""
    begin = tuple(max(0, b - h) for b, h in zip(box[0], halo, strict=True))
    return _box(begin, tuple(min(n, e + h) for n, e, h in zip(shape_zyx, box[1], halo, strict=True)))


def _box(begin: tuple[int, ...], end: tuple[int, ...]) -> Box:
    (z, y, x), (z_end, y_end, x_end) = begin, end
    return (z, y, x), (z_end, y_end, x_end)


def _shape(box: Box) -> Index:
    z, y, x = (end - begin for begin, end in zip(*box, strict=True))
    return z, y, x


def _offset(box: Box, read: Box) -> tuple[int, int, int]:
    """Return the first voxel (x, y, z) of a box in another one that holds it."""
    z, y, x = (b - r for b, r in zip(box[0], read[0], strict=True))
    return x, y, z
