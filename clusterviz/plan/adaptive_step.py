"""Adaptive step: longer slabs in groups of cells where one sample replaces several within a bound on the error.

`quality.adaptive` bounds the error of a pixel. Three things are known of a group: the range of its samples, their
steepness (largest change of the field along a line) and their bend (largest second difference, along an axis or
mixed). Along a line, a trilinear field consists of curves whose changes of slope are bounded by the bend: one sample
in the middle of n slabs differs from the mean of their n samples by at most length/8 · (3 · length + √3) · bend, with
lengths in voxels (Peano's kernel of that difference is at most length/8). The error after the transfer function
follows from the largest slope of extinction κ and emission κc over the range, and from their deviation from lines over
the scalars that a long slab passes: length/8 · steepness times the change of the slope there.

The error of κ or κc relative to κ bounds the error of a pixel, since the weights of a ray's slabs add up to at most 1;
where κ is small, the error along the whole diagonal is less. Each of the two gets half of the bound, and a sixteenth of
the worst case counts: measured errors are less than a fifth of the bound (docs/measurements/accuracy.md).

A long slab begins at a multiple of its length in the lattice of the whole volume and lies in one group, so
neither ranks nor bricks of 8, 16, … cells change it. Bricks of other sizes have other groups; their pictures differ
within the bound.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2
(adaptive sampling). J. Danskin, P. Hanrahan: Fast algorithms for volume ray tracing, Volume Visualization 1992
(β-acceleration).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.errors import SceneError
from clusterviz.plan.blend_mode import is_graded
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.transfer import TransferFunction, distinct
from clusterviz.scene.values import Quality, Volume

Floats = NDArray[np.float64]
LONGEST = 3
"""Most doublings of a slab."""
BINS = 4096
CAUTION = 1 / 16
"""Share of the worst case that is assumed, as a ray does not meet it in all groups; errors stay far below even so."""


@dataclass(frozen=True)
class AdaptiveStep:
    """Bound on the error, and the lengths from which the adaptive step follows."""

    bound: float  # largest error of a pixel
    step_voxels: float  # length of a slab in units of the smallest spacing
    slab_units: float  # length of a slab in opacity unit distances
    diagonal_units: float  # diagonal of the volume, the longest ray, in opacity unit distances

    def doublings(
        self, transfer: TransferFunction, low: Floats, high: Floats, steep: Floats, bend: Floats
    ) -> NDArray[np.uint8]:
        """Return how often slabs may be doubled in groups of cells, 0 to LONGEST.

        `transfer`: the transfer function. `low`, `high`: float64 (n,), data values; NaN where a voxel has none.
        `steep`, `bend`: float64 (n,), data values per voxel and per voxel squared; NaN likewise.
        """
        known = np.isfinite(low) & np.isfinite(high) & np.isfinite(bend) & np.isfinite(steep) & (low <= high)
        found = np.zeros(low.shape, np.uint8)
        some = np.flatnonzero(known)
        terms = _Terms(transfer, low[some], high[some])
        for doubling in range(1, LONGEST + 1):
            slabs = 2.0**doubling
            length = slabs * self.step_voxels
            away = bend[some] * length / 8 * (3 * length + math.sqrt(3.0))
            error, colours = terms.errors(np.minimum(away, high[some] - low[some]), steep[some] * length)
            # The order of absorption within a long slab is lost: at most a quarter of the colours' range.
            order = terms.most * slabs * self.slab_units * colours / 4
            relative = error / np.maximum(terms.least, 1e-300) + order
            absolute = self.diagonal_units * (error + terms.most * order)
            fits = CAUTION * np.minimum(relative, absolute) <= self.bound / 2
            found[some[fits & (found[some] == doubling - 1)]] = doubling
        return found


def make_adaptive_step(volume: Volume, quality: Quality, grid: Grid, transfer: TransferFunction) -> AdaptiveStep | None:
    """Return the adaptive step of `quality.adaptive`; None if it is 0.

    Raises SceneError: the error has no bound, since the volume is lit, for example, or not composited.
    """
    if not quality.adaptive:
        return None
    problem = what_has_no_bound(volume, quality)
    if problem:
        message = f"there is no bound with {problem}"
        raise SceneError(message, where="quality.adaptive", found=quality.adaptive, allowed=0)
    spacing, unit = min(grid.spacing), transfer.unit_distance
    diagonal = math.hypot(*((n - 1) * s for n, s in zip(grid.shape_zyx[::-1], grid.spacing, strict=True)))
    return AdaptiveStep(quality.adaptive, quality.step, quality.step * spacing / unit, diagonal / unit)


def what_has_no_bound(volume: Volume, quality: Quality) -> str:
    """Return the setting that rules out an adaptive step; "" if there is none."""
    problems = {
        f"blending {volume.blending}": not BLEND_MODES[volume.blending].absorbs,
        "isosurfaces": bool(volume.isosurfaces),
        "shade": volume.shade,
        "opacity by the gradient": is_graded(volume),
        f"interpolation {volume.interpolation}": volume.interpolation != "linear",
        "jitter": quality.jitter,
        "slices": quality.renderer == "slices",
        "pre-integrated classification": quality.classification != "post",
    }
    return next((name for name, is_one in problems.items() if is_one), "")


class _Terms:
    """Bounds of the transfer function over intervals of scalars.

    `least`, `most`: float64 (n,), extinction per unit distance.
    """

    def __init__(self, transfer: TransferFunction, low: Floats, high: Floats) -> None:
        knots = distinct(transfer.opacity_values, transfer.colour_values)
        grid = np.linspace(knots[0], knots[-1], BINS + 1)
        self._width = float(grid[1] - grid[0])
        lowest, highest = _extremes(transfer, distinct(knots, grid), grid)
        self._first, self._last = (np.searchsorted(grid, values, side="right") for values in (low, high))
        self.least = column_minima(lowest[:, :1], self._first, self._last)[:, 0]
        self.most = -column_minima(-highest[:, :1], self._first, self._last)[:, 0]
        self._slopes = lowest[:, 1:], highest[:, 1:]
        lows, highs = (column_minima(side, self._first, self._last) for side in (self._slopes[0], -self._slopes[1]))
        self._ranges = -(lows + highs)
        self._steepest = -column_minima(-np.maximum(np.abs(lowest), np.abs(highest))[:, 1:], self._first, self._last)

    def errors(self, away: Floats, passed: Floats) -> tuple[Floats, Floats]:
        """Return the error of extinction and emission together, and the change of the colour, float64 (n,).

        `away`: float64 (n,), largest error of the scalar. `passed`: float64 (n,), change of the scalar along a long
        slab.
        """
        with np.errstate(invalid="ignore"):
            found = self._steepest * away[:, None] + self._bent(passed) * passed[:, None] / 8
            colours = self._steepest[:, 4:].max(axis=1) * passed
        return found[:, 0] + found[:, 1:4].max(axis=1), colours

    def _bent(self, passed: Floats) -> Floats:
        """Return the largest change of slopes over any part of length `passed` of the intervals, float64 (n, 7)."""
        bins = np.ceil(passed / self._width) + 1
        doublings = np.frexp(np.minimum(bins, len(self._slopes[0])))[1]
        found = np.empty((len(passed), 7))
        for doubling in sorted(set(doublings.tolist())):
            some = np.flatnonzero(doublings == doubling)
            lowest, highest = self._slopes[0], -self._slopes[1]
            for reach in (1 << step for step in range(doubling)):
                lowest, highest = _paired(lowest, reach), _paired(highest, reach)
            # Parts inside the interval; the whole interval if it is shorter than a part.
            first, last = self._first[some], self._last[some] - (1 << doubling) + 1
            parts = -column_minima(lowest + highest, first, np.maximum(first, last))
            found[some] = np.where((last < first)[:, None], self._ranges[some], parts)
        return found


def _extremes(transfer: TransferFunction, edges: Floats, grid: Floats) -> tuple[Floats, Floats]:
    """Return extremes of extinction per unit distance, and of the slopes of it, of emission (3) and of colour (3).

    Returns float64 (bins, 8): below the grid, in each of its bins, and above it.
    """
    below = np.nextafter(edges, -np.inf)
    front, back = _values(transfer, edges[:-1]), _values(transfer, below[1:])
    slopes = (back - front) / np.diff(edges)[:, None]
    jumps = np.abs(front - _values(transfer, below[:-1])).max(axis=1) > 1e-9 * (1 + np.abs(front).max(axis=1))
    steep = jumps[:, None]
    low = np.concatenate([np.minimum(front, back)[:, :1], np.where(steep, -np.inf, slopes)], axis=1)
    high = np.concatenate([np.maximum(front, back)[:, :1], np.where(steep, np.inf, slopes)], axis=1)
    starts = np.searchsorted(edges, grid[:-1])
    outside = np.zeros((2, low.shape[1]))
    outside[:, 0] = transfer.extinction(np.array([below[0], edges[-1]])) * transfer.unit_distance
    last = np.abs(_values(transfer, edges[-1:]) - _values(transfer, below[-1:])).max() > 1e-9
    jump = np.where(np.arange(low.shape[1]) > 0, np.inf if last else 0.0, outside[1])
    lowest = np.concatenate([outside[:1], np.minimum.reduceat(low, starts), np.minimum(outside[1:], -jump)])
    highest = np.concatenate([outside[:1], np.maximum.reduceat(high, starts), np.maximum(outside[1:], jump)])
    lowest[-1, 0] = outside[1, 0]
    return lowest, highest


def _values(transfer: TransferFunction, scalars: Floats) -> Floats:
    """Return extinction per unit distance, emission (3) and colour (3), float64 (n, 7)."""
    extinction, colour = transfer.extinction(scalars)[:, None] * transfer.unit_distance, transfer.colour(scalars)
    values: Floats = np.concatenate([extinction, extinction * colour, colour], axis=1)
    return values


def _paired(rows: Floats, reach: int) -> Floats:
    """Return the minimum of each row and the one `reach` rows behind it; the last row continues beyond the end."""
    behind = np.concatenate([rows[reach:], np.repeat(rows[-1:], min(reach, len(rows)), axis=0)])
    less: Floats = np.minimum(rows, behind)
    return less


def column_minima(rows: Floats, first: NDArray[np.intp], last: NDArray[np.intp]) -> Floats:
    """Return column minima over rows `first` to `last`, by tables of spans of 1, 2, 4, … rows."""
    found = np.empty((len(first), rows.shape[1]))
    doublings = np.frexp(last - first + 1)[1] - 1
    for doubling in range(int(doublings.max(initial=0)) + 1):
        some = np.flatnonzero(doublings == doubling)
        found[some] = np.minimum(rows[first[some]], rows[last[some] - (1 << doubling) + 1])
        rows = _paired(rows, 1 << doubling)
    return found
