"""Three-dimensional line integral convolution: noise that is smeared along the lines of a vector field.

The value of a voxel is the mean of the noise along the line through it, half of it forwards and half backwards, with
weights by the distance. `LicSource` computes any box of it when it is read. The box needs vectors and noise as far
around it as half a line, so it is the same for any bricks and on any ranks.

A line ends at the border of the grid, at NaN and where vectors are 0; the mean is then that of what is left. Vectors
between samples are linear in each cell, and a cell with a sample of NaN has none. The value is NaN at samples without
vectors, and the voxel's own noise where vectors are 0.

References
----------
Cabral, Leedom, Imaging vector fields using line integral convolution, SIGGRAPH 1993.
Wegenkittl, Gröller, Purgathofer, Animating flow fields: rendering of oriented line integral convolution, Computer
Animation 1997 (the ramp kernel).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.flow.section import Lic
from clusterviz.data.bricks import Box
from clusterviz.data.header import check_box
from clusterviz.data.source import IDENTITY, Grid, Index
from clusterviz.data.vectors import VectorArray, VectorSource
from clusterviz.flow.noise import Noise
from clusterviz.jobs.blocks import Blocks, make_blocks
from clusterviz.jobs.device import current_device, on_device
from clusterviz.jobs.kernel import Kernel, kernel

STEPPERS = {"euler": "step_euler.glsl", "rk4": "step_rk4.glsl", "rk45": "step_rk45.glsl"}
"""Shaders that step along a line, by the integrator."""
BLOCK = 64
"""Samples a side of the boxes that are computed at once; a multiple of it where halos are wider, or half of it where
ranks are many."""
CACHE_BYTES = 1 << 30
LAYERS = 8
STRETCHED = (1.0, 99.0)
"""Percentiles of the values that become 0 and 1."""
Floats = NDArray[np.float32]


def line_weights(kernel: str, length: float, step: float) -> Floats:
    """Return the weights of the samples along a line, float32 (2 · steps + 1,), from the upstream end.

    "box" are equal; "hann" fade to both ends; "ramp" fade upstream, where lines of a spot begin, so that these grow
    brighter along the flow. The first weight of 0 would be a step beyond the ends.
    """
    steps = int(length / 2 / step + 1e-6)
    place = np.arange(-steps, steps + 1) / (steps + 1)
    window = {"box": np.ones_like(place), "hann": 0.5 + 0.5 * np.cos(np.pi * place), "ramp": 0.5 - 0.5 * place}
    return window[kernel].astype(np.float32)


def steps_of(lic: Lic) -> int:
    """Return the steps of half a line."""
    return len(line_weights("box", lic.length, lic.step)) // 2


def halo_of(lic: Lic, grid: Grid, steps: int) -> Index:
    """Return how many samples beside a place are read, along z, y, x, when a line goes so many steps from there."""
    # Places are rounded.
    z, y, x = (np.floor(steps * lic.step * samples_per_length(grid) + 1e-3).astype(int) + 1)[::-1].tolist()
    return (z, y, x) if steps else (0, 0, 0)


def blocks_of(grid: Grid, lic: Lic, ranks: int = 1) -> Blocks:
    """Return the blocks that are computed at once: wide for long lines, but one for each rank where possible."""
    wide = max(1, -(-max(halo_of(lic, grid, steps_of(lic))) // BLOCK))
    sides = (*range(wide * BLOCK, 0, -BLOCK), BLOCK // 2)
    each = [make_blocks(grid.shape_zyx, side, "lic") for side in sides]
    return next((blocks for blocks in each if np.prod(blocks.counts_zyx) >= ranks), each[-1])


def noise_of(lic: Lic) -> Noise:
    """Return the noise that is convolved."""
    return Noise(lic.noise, lic.density, lic.blur, lic.seed, lic.phase)


def samples_per_length(grid: Grid) -> NDArray[np.float64]:
    """Return how many samples along x, y, z the smallest spacing is; 0 along an axis with one sample."""
    spacing = np.asarray(grid.spacing)
    used = np.asarray(grid.shape_zyx[::-1]) > 1
    return np.where(used, (spacing[used] if used.any() else spacing).min() / spacing, 0.0)


@dataclass(frozen=True)
class Field:
    """Vectors and noise of a box, as the shaders take them.

    Attributes
    ----------
    values : float32 (z, y, x, 4): vectors along the axes of the grid, times a power of 2, and noise
    begin_zyx : of the box
    exponent : of the power of 2 that was taken out of the vectors
    """

    values: Floats
    begin_zyx: Index
    exponent: int


def read_field(vectors: VectorSource, noise: Noise, begin_zyx: Index, end_zyx: Index) -> Field:
    """Read the vectors and the noise of a box."""
    grid = vectors.grid
    read = vectors.read(begin_zyx, end_zyx)
    if grid.direction != IDENTITY:
        read = read @ np.linalg.inv(np.asarray(grid.direction)).T.astype(read.dtype)
    # Squares of vectors are neither too large nor too small for float32, and a power of 2 keeps their bits.
    _, exponent = np.frexp(max(np.fmax.reduce(read, axis=None), -np.fmin.reduce(read, axis=None)))
    exponent = int(np.clip(exponent, -126, 126))
    values = np.empty((*read.shape[:3], 4), np.float32)
    for axis, side in enumerate(grid.shape_zyx[::-1]):
        np.multiply(
            read[..., axis], read.dtype.type(2.0**-exponent * (side > 1)), out=values[..., axis], casting="same_kind"
        )
    values[..., 3] = noise.read(grid.shape_zyx, begin_zyx, end_zyx)
    return Field(values, begin_zyx, exponent)


def _lic(  # type: ignore[no-untyped-def]
    field, weights, lic, box_begin,
    first_voxel, last_voxel, samples_per_length, step_length, steps, by_speed, tolerance,
):  # fmt: skip
    """Convolve: means of the noise along the lines of voxels."""


def line_kernels(function: Callable[..., None], file: str, writes: Sequence[str]) -> dict[str, Kernel]:
    """Return the kernels of a function for all integrators; `file` follows those of lines and steps."""
    return {
        name: kernel("numbers.glsl", "line.glsl", stepper, file, writes=writes, vectors=("field",))(function)
        for name, stepper in STEPPERS.items()
    }


_KERNELS = line_kernels(_lic, "lic.glsl", ("lic",))


class LicSource:
    """Line integral convolution of vectors as a volume; see `Source`.

    Blocks are computed when they are first read, on the device of the thread that has made the source, and kept as long
    as memory allows, the last used ones longest.

    Parameters
    ----------
    vectors : one time step
    lic : how lines are convolved
    cache_bytes : memory for blocks that are kept
    ranks : that share the blocks

    Attributes
    ----------
    blocks : division of the grid
    voxels_computed, halo_voxels : so far, and those of which vectors and noise were read beside
    """

    dtype = np.dtype(np.float32)

    def __init__(
        self, vectors: VectorSource, lic: Lic | None = None, cache_bytes: int = CACHE_BYTES, ranks: int = 1
    ) -> None:
        self.vectors, self.lic = vectors, lic or Lic()
        self.name, self.grid = f"{vectors.name} (lic)", vectors.grid
        self.blocks = blocks_of(self.grid, self.lic, ranks)
        self.voxels_computed = self.halo_voxels = 0
        self._device = current_device()
        self._cache_bytes, self._kept, self._lock = cache_bytes, OrderedDict[Index, Floats](), Lock()

    def read(self, begin_zyx: Index, end_zyx: Index) -> Floats:
        """Compute the values of a box, 0 to 1, or take those that are kept; see `Source.read`."""
        found = np.empty(check_box(begin_zyx, end_zyx, self.grid.shape_zyx), np.float32)
        for number, part in self.blocks.shared((begin_zyx, end_zyx)):
            found[_slices(part, begin_zyx)] = self._block(number)[_slices(part, self.blocks.box(number)[0])]
        return found

    def read_boxes(self, boxes: Sequence[Box]) -> list[Floats]:
        """Return the values of several boxes, without those of blocks between them."""
        return [self.read(*box) for box in boxes]

    def _block(self, number: Index) -> Floats:
        with self._lock:
            if number not in self._kept:
                self._kept[number] = self._computed(*self.blocks.box(number))
            self._kept.move_to_end(number)
            while len(self._kept) > 1 and sum(block.nbytes for block in self._kept.values()) > self._cache_bytes:
                self._kept.popitem(last=False)
            return self._kept[number]

    @cached_property
    def _speed(self) -> float:
        """The largest of the whole grid, if steps depend on it."""
        return fastest(self.vectors, (0, 0, 0), self.grid.shape_zyx) if self.lic.by_speed else 0.0

    def _computed(self, begin_zyx: Index, end_zyx: Index) -> Floats:
        first, last = grown(self.grid, begin_zyx, end_zyx, halo_of(self.lic, self.grid, steps_of(self.lic)))
        field = read_field(self.vectors, noise_of(self.lic), first, last)
        with on_device(self._device):
            values = convolve_box(field, self.grid, self.lic, begin_zyx, end_zyx, self._speed)
            self.voxels_computed += values.size
            self.halo_voxels += field.values.size // 4 - values.size
            return stretched(values, self.lic)


def _slices(box: Box, origin: Index) -> tuple[slice, ...]:
    return tuple(slice(b - o, e - o) for b, e, o in zip(*box, origin, strict=True))


def grown(grid: Grid, begin_zyx: Index, end_zyx: Index, halo_zyx: Index) -> tuple[Index, Index]:
    """Return a box with a halo, cut at the grid."""
    first = tuple(max(0, b - h) for b, h in zip(begin_zyx, halo_zyx, strict=True))
    last = tuple(min(n, e + h) for n, e, h in zip(grid.shape_zyx, end_zyx, halo_zyx, strict=True))
    return first, last  # type: ignore[return-value]


def line_numbers(field: Field, grid: Grid, lic: Lic, speed: float) -> tuple[Any, ...]:
    """Return what the shaders know of lines: first_voxel … tolerance; see line.glsl."""
    first = tuple(-b for b in field.begin_zyx[::-1])
    last = tuple(n - 1 - b for n, b in zip(grid.shape_zyx[::-1], field.begin_zyx[::-1], strict=True))
    by_speed = float(np.ldexp(1 / speed, field.exponent)) if lic.by_speed and speed > 0 else 0.0
    return (
        first,
        last,
        tuple(samples_per_length(grid).tolist()),
        float(lic.step),
        steps_of(lic),
        by_speed,
        float(lic.tolerance),
    )


def convolve_box(field: Field, grid: Grid, lic: Lic, begin_zyx: Index, end_zyx: Index, speed: float = 0.0) -> Floats:
    """Return the means along the lines of a box's voxels, of which the field holds all: float32, not stretched.

    Parameters
    ----------
    speed : the largest of the whole grid, if steps are by speed
    """
    values = np.empty([e - b for b, e in zip(begin_zyx, end_zyx, strict=True)], np.float32)
    first = tuple(b - f for b, f in zip(begin_zyx[::-1], field.begin_zyx[::-1], strict=True))
    weights = line_weights(lic.kernel, lic.length, lic.step)
    _KERNELS[lic.integrator][values.shape](field.values, weights, values, first, *line_numbers(field, grid, lic, speed))
    return values


def fastest(vectors: VectorSource, begin_zyx: Index, end_zyx: Index) -> float:
    """Return the largest speed of the vectors in a box, of which a few layers are read at a time."""
    found, speeds = 0.0, SpeedSource(vectors)
    for z in range(begin_zyx[0], end_zyx[0], LAYERS):
        read = speeds.read((z, *begin_zyx[1:]), (min(z + LAYERS, end_zyx[0]), *end_zyx[1:]))
        found = max(found, float(np.max(read, initial=0.0, where=np.isfinite(read))))
    return found


def stretched(values: Floats, lic: Lic) -> Floats:
    """Stretch the contrast of values, in place, by a function of the settings alone."""
    if lic.contrast:
        low, high = _contrast(lic.model_copy(update={"integrator": "euler", "by_speed": False, "tolerance": 1.0}))
        values -= np.float32(low)
        values *= np.float32(1 / max(high - low, 1e-6))
        np.clip(values, 0.0, 1.0, out=values)
    return values


@cache
def _contrast(lic: Lic) -> tuple[float, float]:
    """Return the values that become 0 and 1: percentiles of the convolution of noise along straight lines."""
    found = []
    far = min(halo_of(lic, Grid((2, 2, 2)), steps_of(lic))[0], 64)
    side = 32 + 2 * far
    for direction in ((0.0, 0.0, 1.0), (0.0, 0.6, 0.8), (2 / 3, 1 / 3, 2 / 3)):
        vectors = VectorArray(np.broadcast_to(np.array(direction, np.float32), (side, side, side, 3)))
        field = read_field(vectors, noise_of(lic), (0, 0, 0), (side,) * 3)
        found.append(convolve_box(field, vectors.grid, lic, (far,) * 3, (far + 32,) * 3))
    low, high = np.percentile(found, STRETCHED)
    return float(low), float(high)


class SpeedSource:
    """Lengths of vectors as a volume; see `Source`."""

    dtype = np.dtype(np.float32)

    def __init__(self, vectors: VectorSource) -> None:
        self.vectors, self.name, self.grid = vectors, f"{vectors.name} (speed)", vectors.grid

    def read(self, begin_zyx: Index, end_zyx: Index) -> Floats:
        """Compute the lengths of a box, NaN where there are no vectors; see `Source.read`."""
        vectors = self.vectors.read(begin_zyx, end_zyx).astype(np.float64)
        squared: NDArray[np.float64] = np.einsum("...i,...i", vectors, vectors)
        return np.sqrt(squared).astype(np.float32)
