"""Oracles of the sampling distance: how far apart samples around a point of a volume may be.

Each gives every block of cells a distance of its own. Around a point, samples may be as far apart as is allowed there,
and in every other block by as much more as it is away: so skipped samples never reach into a block that needs more of
them. Distances are in cells.

- `distance_to_change`: the transfer function changes by no more than a tolerance over the block's scalars, as in [1].
  Nothing is assumed of the field but its range.
- `distance_by_bend`: interpolating the field linearly over the distance changes opacity and emission by no more than
  a tolerance, by its second differences and the steepest slope of the transfer function over the block's scalars.

References
----------
[1] M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 4.3.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.adaptive_step import column_minima
from clusterviz.scene.transfer import TransferFunction

BLOCK = 4
"""Cells along the side of a block."""
BINS = 2048
FARTHEST = 64.0
"""Cells."""
LINEAR_ERROR = 3 / 8
"""Largest error of linear interpolation along three axes, in second differences over the square of the distance."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SamplingOracle:
    """Sampling distances in blocks of a volume."""

    distances: NDArray[np.float32]  # float32 (z, y, x), in cells; below 1, or NaN: as close as possible
    block: int = BLOCK  # cells along the side of a block


def distance_to_change(voxels: NDArray[Any], transfer: TransferFunction, tolerance: float) -> SamplingOracle:
    """Return the oracle of the change of the transfer function over a block.

    `voxels`: (z, y, x), finite. `tolerance`: largest change of opacity over a unit distance, or of opacity times
    colour.
    """
    low, high = _range_of_blocks(voxels)
    least, most = _extremes(_rows(transfer), *_bins(transfer, low, high))
    return _enveloped(np.where((most - least).max(axis=-1) > tolerance, 0.0, FARTHEST))


def distance_by_bend(voxels: NDArray[Any], transfer: TransferFunction, tolerance: float) -> SamplingOracle:
    """Return the oracle of the error of linear interpolation.

    `voxels`: (z, y, x), finite. `tolerance`: largest error of opacity over a unit distance, or of opacity times colour,
    above 0.
    """
    low, high = _range_of_blocks(voxels)
    values = voxels.astype(np.float64)
    bends = np.zeros(voxels.shape)
    for axis in range(3):
        inner = np.abs(np.diff(values, 2, axis=axis))
        bends = np.maximum(bends, np.pad(inner, [(1, 1) if axis == one else (0, 0) for one in range(3)], mode="edge"))
    bend = _of_blocks(bends, np.maximum)
    rows, edges = _rows(transfer), _edges(transfer)
    slopes = np.abs(np.diff(rows, axis=0)) / (edges[1] - edges[0])
    slope = _extremes(np.concatenate([slopes, slopes[-1:]]), *_bins(transfer, low - bend, high + bend))[1].max(axis=-1)
    error = LINEAR_ERROR * slope * bend
    return _enveloped(np.sqrt(np.minimum(tolerance / np.maximum(error, 1e-300), FARTHEST**2)))


def _enveloped(allowed: Floats) -> SamplingOracle:
    """Return the largest distances that reach into no block by more than it allows."""
    nearest = found = allowed
    for blocks in range(int(FARTHEST) // BLOCK):
        nearest = _least_beside(nearest)
        # Of two blocks that touch, no cell may lie between the points.
        found = np.minimum(found, nearest + BLOCK * blocks)
    return SamplingOracle(found.astype(np.float32))


def _least_beside(values: Floats) -> Floats:
    """Return the least of each block and its 26 neighbours."""
    found = values
    for axis in range(3):
        padded = np.pad(found, [(int(axis == other),) * 2 for other in range(3)], mode="edge")
        found = np.min([np.take(padded, np.arange(found.shape[axis]) + shift, axis=axis) for shift in range(3)], axis=0)
    return found


def _range_of_blocks(voxels: NDArray[Any]) -> tuple[Floats, Floats]:
    return _of_blocks(voxels, np.minimum), _of_blocks(voxels, np.maximum)


def _of_blocks(voxels: NDArray[Any], reduce: np.ufunc) -> Floats:
    """Return extremes of the samples of blocks of cells, with those that the next block has too."""
    found = voxels.astype(np.float64)
    for axis in range(3):
        cells = max(1, found.shape[axis] - 1)
        starts = np.arange(0, cells, BLOCK)
        inner = reduce.reduceat(found, starts, axis=axis)
        ends = np.take(found, np.minimum(starts + BLOCK, found.shape[axis] - 1), axis=axis)
        found = reduce(inner, ends)
    return found


def _edges(transfer: TransferFunction) -> Floats:
    knots = np.concatenate([transfer.opacity_values, transfer.colour_values])
    return np.linspace(knots.min(), knots.max(), BINS + 1)


def _rows(transfer: TransferFunction) -> Floats:
    """Return opacity and premultiplied colour at the edges, float64 (BINS + 1, 4)."""
    opacity = transfer.opacity(_edges(transfer))[:, None]
    return np.concatenate([opacity, opacity * transfer.colour(_edges(transfer))], axis=1)


def _bins(transfer: TransferFunction, low: Floats, high: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and the last edge around two scalars each."""
    edges = _edges(transfer)
    return np.clip(np.searchsorted(edges, low) - 1, 0, BINS), np.clip(np.searchsorted(edges, high), 0, BINS)


def _extremes(rows: Floats, first: NDArray[np.intp], last: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return the least and the greatest of each column over rows `first` to `last`, float64 (…, columns)."""
    ends, shape = (first.ravel(), last.ravel()), (*first.shape, rows.shape[1])
    return column_minima(rows, *ends).reshape(shape), -column_minima(-rows, *ends).reshape(shape)
