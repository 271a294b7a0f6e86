"""Surface LIC: line integral convolution of noise along vectors on the visible surfaces of a picture, in image space.

The vectors at the visible points of a surface are projected to its tangent plane and to the screen. Lines follow them
from pixel to pixel (shaders/flow/surface_lic.glsl), over noise that is attached to the world: it moves with the surface
when the camera does, and its grains keep their size in pixels. A line ends at silhouettes, at points without vectors,
and at the sides of the picture. It goes on across creases, where the surface is whole.

Over ranks each pixel's point is sampled where it was found: by the rank that has drawn its brick (sort-last) or its
tile (sort-first). The ranks then exchange these pixels, so that each has a band of rows, with as many more on each side
as a line is long. Nothing that is computed for a pixel depends on the band, so results are the same on any ranks, bit
for bit, if the points are.

Cost: 44 bytes sent for each visible pixel of a surface (more where bands overlap), and four interpolations for each
step of a line. Limits: a pixel shows one surface, that with which its opacity passes one half; points have the float32
precision of a view depth; lines are as long on the screen, not on the surface, so they are shortened where it is seen
at a grazing angle.

References
----------
S. Bachthaler, M. Strengert, D. Weiskopf, T. Ertl: Parallel texture-based vector field visualization on curved surfaces
using GPU cluster computers, Eurographics Symposium on Parallel Graphics and Visualization 2006.
R. S. Laramee, B. Jobard, H. Hauser: Image space based visualization of unsteady flow on surfaces, IEEE Visualization
2003.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clusterviz import jobs
from clusterviz.comm import Channel, all_to_all
from clusterviz.data.source import Grid, Index
from clusterviz.data.vectors import VectorSource
from clusterviz.flow.glyphs import interpolated
from clusterviz.flow.lic import STEPPERS
from clusterviz.plan.view import View

Floats = NDArray[np.float64]
TAG = 91
LEVELS = 64
"""Lattices of noise, as in surface_field.glsl."""
MARGIN = 3
"""Rows beyond the end of a line: pixels between which directions are interpolated, and their neighbours."""
ALONG_VIEW = 1e-6
"""Share of a vector's length below which its projection to the screen has no direction."""
BLOCK = 32
"""Cells along the side of a block of vectors that is read at once."""


@jobs.kernel("surface_field.glsl", writes=("field",), vectors=("surface", "directions", "field"))
def _surface_field(surface, directions, camera, field, first_row, first_level, seed, grain, phase):  # type: ignore[no-untyped-def]
    """Compute the direction, the noise and the links of each pixel."""


def _lic(field, weights, lic, skipped_rows, step_pixels):  # type: ignore[no-untyped-def]
    """Convolve the noise along the line of each pixel."""


_KERNELS = {
    name: jobs.kernel("surface_line.glsl", STEPPERS[name], "surface_lic.glsl", writes=("lic",), vectors=("field",))(
        _lic
    )
    for name in ("euler", "rk4")
}


@dataclass(frozen=True, eq=False)
class Convolution:
    """Lines and noise of a surface LIC.

    Attributes
    ----------
    weights : float32 (2n + 1,), of the samples along a line from its begin to its end
    step : distance of the samples in pixels, at most 1
    integrator : euler or rk4
    grain : size of a grain of the noise in pixels
    seed : 32 bits that choose the noise
    phase : of the animation, in periods
    """

    weights: NDArray[np.float32]
    step: float
    integrator: str = "rk4"
    grain: float = 1.5
    seed: int = 1
    phase: float = 0.0

    @property
    def halo(self) -> int:
        """Rows of pixels that a line may reach on each side of its own, and those that its samples need."""
        return math.ceil((len(self.weights) // 2) * self.step) + MARGIN


@dataclass(frozen=True, eq=False)
class SurfacePixels:
    """Visible points of surfaces with a vector, one a pixel.

    Attributes
    ----------
    number : int32 (n,), of the pixel, row by row
    depth : float32 (n,), along the view in world units
    normal : float32 (n, 3), in the world
    direction : float32 (n, 2), of the vector on the screen, a unit vector to the right and down
    speed : float32 (n,), length of the vector
    light : float32 (n, 3), what the surface adds to the pixel
    """

    number: NDArray[np.int32]
    depth: NDArray[np.float32]
    normal: NDArray[np.float32]
    direction: NDArray[np.float32]
    speed: NDArray[np.float32]
    light: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.number)

    def words(self, some: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Return some of the pixels as numbers that can be sent, int32 (11 n,)."""
        columns = self.depth[:, None], self.normal, self.direction, self.speed[:, None], self.light
        floats = np.concatenate([column[some] for column in columns], axis=1)
        return np.concatenate([self.number[some, None], floats.view(np.int32)], axis=1).ravel()

    @classmethod
    def from_words(cls, words: NDArray[np.int32]) -> SurfacePixels:
        """Return pixels in ascending order from `words`; of several points in a pixel the nearest."""
        rows = words.reshape(-1, WORDS)
        floats = np.ascontiguousarray(rows[:, 1:]).view(np.float32)
        order = np.lexsort((floats[:, 0], rows[:, 0]))
        numbers = rows[order, 0]
        order = order[np.flatnonzero(np.diff(numbers, prepend=-1))]
        floats = floats[order]
        return cls(rows[order, 0], floats[:, 0], floats[:, 1:4], floats[:, 4:6], floats[:, 6], floats[:, 7:])


WORDS = 11


class VectorSamples:
    """Vectors at points of the world, interpolated linearly between the samples of a source.

    Blocks of the source that were read are kept for the next picture if it needs them.

    Parameters
    ----------
    source : of the vectors
    """

    def __init__(self, source: VectorSource) -> None:
        self.source, self._blocks = source, dict[Index, NDArray[np.float32 | np.float64]]()
        self._index_from_world = np.linalg.inv(source.grid.world_from_index[:3, :3])

    def at(self, points: Floats) -> Floats:
        """Return vectors of the world.

        Parameters
        ----------
        points : float64 (n, 3), (x, y, z) in the world

        Returns
        -------
        vectors : float64 (n, 3), NaN outside of the grid, and beside samples that are NaN
        """
        shape = np.array(self.source.grid.shape_zyx[::-1])
        # Sums in a fixed order, as those of a matrix product depend on how many points there are.
        offsets, rows = points - np.array(self.source.grid.origin), self._index_from_world
        index = np.stack([sum(row[axis] * offsets[:, axis] for axis in range(3)) for row in rows], axis=1)
        with np.errstate(invalid="ignore"):
            inside = ((index >= -OUTSIDE) & (index <= shape - 1 + OUTSIDE)).all(axis=1)
        found = np.full(points.shape, np.nan)
        index = np.clip(index[inside], 0, shape - 1)
        cells = np.minimum(np.floor(index).astype(np.int64), np.maximum(shape - 2, 0))
        values, blocks, counts = np.empty(index.shape), cells // BLOCK, -(-shape // BLOCK)
        number = (blocks[:, 2] * counts[1] + blocks[:, 1]) * counts[0] + blocks[:, 0]
        order = np.argsort(number, kind="stable")
        begins = np.flatnonzero(np.diff(number[order], prepend=-1))
        kept, self._blocks = self._blocks, {}
        for begin, end in pairwise([*begins.tolist(), len(order)]):
            some = order[begin:end]
            x, y, z = blocks[some[0]].tolist()
            block = kept.get((z, y, x))
            self._blocks[z, y, x] = block = self._read((z, y, x)) if block is None else block
            values[some] = interpolated(block, cells[some] - BLOCK * blocks[some], (index - cells)[some])
        found[inside] = values
        return found

    def _read(self, block: Index) -> NDArray[np.float32 | np.float64]:
        """Read a block with the first samples of the next ones."""
        ends = zip(block, self.source.grid.shape_zyx, strict=True)
        z_end, y_end, x_end = (min(BLOCK * (n + 1) + 1, side) for n, side in ends)
        z, y, x = (BLOCK * n for n in block)
        return self.source.read((z, y, x), (z_end, y_end, x_end))


OUTSIDE = 1e-3
"""Voxels by which a point may be outside of the grid, by its rounding."""


def points_of(view: View, columns: NDArray[np.int64], rows: NDArray[np.int64], depth: NDArray[np.float32]) -> Floats:
    """Return the points (n, 3) in the world of pixels at view depths; the view is in the world."""
    across, above = _on_screen(view, columns, rows)
    scale = 1.0 if view.parallel else depth.astype(np.float64)
    parts = (across * scale, view.right), (above * scale, view.up), (depth.astype(np.float64), view.forward)
    found: Floats = np.array(view.eye) + sum(lengths[:, None] * np.array(axis) for lengths, axis in parts)
    return found


def _on_screen(view: View, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Return distances of pixels to the right of the picture's centre and above it, as `View.pixel`."""
    column, row = view.centre
    across, above = columns.astype(np.float64) + 0.5 - column, row - 0.5 - rows.astype(np.float64)
    return across * view.pixel, above * view.pixel


def screen_directions(
    view: View,
    columns: NDArray[np.int64],
    rows: NDArray[np.int64],
    depth: NDArray[np.float32],
    normals: NDArray[np.float32],
    vectors: Floats,
) -> NDArray[np.float32]:
    """Project vectors at points of a surface to its tangent plane, and to the screen.

    Parameters
    ----------
    normals, vectors : (n, 3), in the world

    Returns
    -------
    directions : float32 (n, 2), unit vectors to the right and down; zeros where there is no vector, no normal, or where
        the projection has no direction
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        scaled = vectors / np.abs(vectors).max(axis=1, keepdims=True)
        n = normals.astype(np.float64)
        tangential = scaled - n * _dot(n, scaled)[:, None] / _dot(n, n)[:, None]
        right, up, ahead = (_dot(tangential, np.array(axis)) for axis in (view.right, view.up, view.forward))
        if not view.parallel:
            across, above = _on_screen(view, columns, rows)
            right, up = right - across * ahead, up - above * ahead
        length = np.hypot(right, up)
        found = np.stack([right / length, -up / length], axis=1)
        return np.where((length > ALONG_VIEW)[:, None] & np.isfinite(found), found, 0.0).astype(np.float32)


def _dot(a: Floats, b: Floats) -> Floats:
    """Return products of rows; the order of the sum does not depend on their number."""
    found: Floats = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return found


def exchange(
    channel: Channel, pixels: SurfacePixels, size: tuple[int, int], halo: int
) -> tuple[int, int, SurfacePixels]:
    """Exchange pixels, so that each rank has those of a band of rows and of the rows near it; collective.

    Bands hold as many pixels of surfaces each, as far as whole rows can.

    Parameters
    ----------
    pixels : that this rank has found
    size : width and height of the picture
    halo : rows on each side of a band

    Returns
    -------
    begin, end : rows of this rank's band
    found : its pixels and those of the halo
    """
    rows = pixels.number // size[0]
    found = channel.allgather_numbers(np.bincount(rows, minlength=size[1])).sum(axis=0)
    # Ties of empty rows are broken by the rows themselves, so that no band is far from its share of both.
    before = np.concatenate([[0], np.cumsum(found * size[1] + 1)])
    edges = np.searchsorted(before, before[-1] * np.arange(channel.size + 1) / channel.size)
    edges[0], edges[-1] = 0, size[1]
    parts = [pixels.words((rows >= begin - halo) & (rows < end + halo)) for begin, end in pairwise(edges.tolist())]
    lengths = channel.allgather_numbers([len(part) for part in parts])
    received = all_to_all(channel, parts, TAG, lengths[:, channel.rank].tolist())
    begin, end = edges[channel.rank : channel.rank + 2].tolist()
    return begin, end, SurfacePixels.from_words(np.concatenate(received))


def convolved(
    view: View, grid: Grid, pixels: SurfacePixels, rows: tuple[int, int], convolution: Convolution
) -> NDArray[np.float32]:
    """Convolve noise along the lines of a band of rows.

    Parameters
    ----------
    view : in the world
    grid : of the vectors, at whose middle the noise begins
    pixels : of the rows and of `Convolution.halo` rows around them
    rows : begin and end of the band

    Returns
    -------
    lic : float32 (end - begin, width); −1 where a pixel has no line
    """
    (width, height), (begin, end) = view.size, rows
    first, last = max(0, begin - convolution.halo), min(height, end + convolution.halo)
    lic = np.full((end - begin, width), -1, np.float32)
    at = pixels.number - first * width
    at = at[here := (at >= 0) & (at < (last - first) * width)]
    if begin >= end or not len(at):
        return lic
    image = last - first, width
    surface, directions, field = (np.zeros((*image, size), np.float32) for size in (4, 2, 4))
    flat = surface.reshape(-1, 4), directions.reshape(-1, 2)
    flat[0][at, 0], flat[0][at, 1:], flat[1][at] = (
        each[here] for each in (pixels.depth, pixels.normal, pixels.direction)
    )
    camera, first_level = _camera(view, grid, convolution.grain)
    seed = int(np.array(convolution.seed & 0xFFFFFFFF, np.uint32).view(np.int32))
    numbers = first, first_level, seed, float(convolution.grain), float(convolution.phase)
    _surface_field[image](surface, directions, camera, field, *numbers)
    weights = np.ascontiguousarray(convolution.weights, np.float32)
    _KERNELS[convolution.integrator][lic.shape](field, weights, lic, begin - first, float(convolution.step))
    return lic


def _camera(view: View, grid: Grid, grain: float) -> tuple[Floats, int]:
    """Return the numbers of a view for surface_field.glsl, float64 (n,), and the first level of the noise."""
    corners = np.array(grid.corners)
    origin = corners.mean(axis=0)
    reach = np.linalg.norm(corners - origin, axis=1).max()
    farthest = 1.0 if view.parallel else float(np.linalg.norm(origin - np.array(view.eye)) + reach)
    last_level = math.frexp(grain * view.pixel * farthest)[1] + 1
    first_level = last_level - LEVELS + 1
    scales = [math.ldexp(1.0, -level) for level in range(first_level, last_level + 1)]
    numbers = [*view.eye, *view.right, *view.up, *view.forward, view.pixel, float(view.parallel), *view.centre, *origin]
    return np.array([*numbers, *scales]), first_level


def stretched(channel: Channel, lic: NDArray[np.float32]) -> NDArray[np.float32]:
    """Stretch the values of all ranks, so that two standard deviations around their mean are 0 to 1; collective.

    Sums are of whole numbers, so that they do not depend on the ranks.

    Parameters
    ----------
    lic : float32 of this rank; −1 where there is none, which stays
    """
    units = np.rint(lic[lic >= 0].astype(np.float64) * UNITS).astype(np.int64)
    sums = channel.allgather_numbers([len(units), int(units.sum()), int((units * units).sum())])
    count, total, squares = (sum(column) for column in sums.T.tolist())
    if not count:
        return lic
    mean, deviation = total / count / UNITS, math.sqrt(max(0, count * squares - total * total)) / count / UNITS
    scale = 0.25 / max(deviation, 1 / UNITS)
    found = np.clip(0.5 + (lic - np.float32(mean)) * np.float32(scale), 0, 1)
    return np.where(lic < 0, lic, found).astype(np.float32)


UNITS = 1 << 16


def change(
    pixels: SurfacePixels, lic: NDArray[np.float32], first_row: int, strength: float, tints: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return what painting adds to the pixels of a band, float32 (rows, width, 3), at most zero.

    A surface's light is multiplied by its tint and by 1 − strength · (1 − lic); without a line, the pattern is gray.

    Parameters
    ----------
    pixels : with those of the band, which begins with `first_row`
    lic : float32 (rows, width), from 0 to 1; negative where there is none
    tints : float32 (n, 3), of the pixels, in 0..1
    """
    rows, width = lic.shape
    found = np.zeros((rows * width, 3), np.float32)
    at = pixels.number - first_row * width
    here = (at >= 0) & (at < rows * width)
    at = at[here]
    values = lic.reshape(-1)[at]
    pattern = 1 - np.float32(strength) * (1 - np.where(values < 0, np.float32(0.5), values))
    found[at] = pixels.light[here] * (tints[here] * pattern[:, None] - 1)
    return found.reshape(rows, width, 3)
