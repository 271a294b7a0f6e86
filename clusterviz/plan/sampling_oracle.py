"""Oracle of the sampling distance: how far apart samples around a point may be.

In blocks of cells where the transfer function changes by more than a tolerance over the range of the scalars, samples
are as close as possible; elsewhere as far apart as the distance to the nearest such block. That distance changes by at
most one for each step aside, so no skipped sample lies in such a block.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 4.3.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.scene.transfer import TransferFunction

BLOCK = 4
"""Cells along the side of a block."""
BINS = 2048
FARTHEST = 64.0
"""Cells."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SamplingOracle:
    """Sampling distances in blocks of a volume.

    Attributes
    ----------
    distances : float32 (z, y, x), in cells; below 1, or NaN: as close as possible
    block : cells along the side of a block
    """

    distances: NDArray[np.float32]
    block: int = BLOCK


def distance_to_change(voxels: NDArray[Any], transfer: TransferFunction, tolerance: float) -> SamplingOracle:
    """Return the oracle of a transfer function.

    Parameters
    ----------
    voxels : (z, y, x), finite
    tolerance : change of opacity over a unit distance, or of opacity times colour, within a block, up to which samples
        may be far apart
    """
    low, high = (_of_blocks(voxels, reduce) for reduce in (np.minimum, np.maximum))
    busy = _changes(transfer, low.ravel(), high.ravel()).reshape(low.shape) > tolerance
    distances = np.where(busy, 0.0, FARTHEST)
    for passed in range(int(FARTHEST) // BLOCK):
        busy = _grown(busy)
        # Of points in the nearest cells of the block.
        distances = np.where(busy, np.minimum(distances, max(1.0, float(BLOCK * passed))), distances)
    return SamplingOracle(distances.astype(np.float32))


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


def _changes(transfer: TransferFunction, low: Floats, high: Floats) -> Floats:
    """Return the largest change of opacity, or of opacity times colour, between two scalars each, float64 (n,)."""
    knots = np.concatenate([transfer.opacity_values, transfer.colour_values])
    edges = np.linspace(knots.min(), knots.max(), BINS + 1)
    opacity = transfer.opacity(edges)[:, None]
    rows = np.concatenate([opacity, opacity * transfer.colour(edges)], axis=1)
    first, last = (np.clip(np.searchsorted(edges, values) + shift, 0, BINS) for values, shift in ((low, -1), (high, 0)))
    least, most = rows, rows
    found = np.zeros(len(low))
    doublings = np.frexp(last - first + 1)[1] - 1
    for doubling in range(int(doublings.max(initial=0)) + 1):
        some = np.flatnonzero(doublings == doubling)
        ends = first[some], last[some] - (1 << doubling) + 1
        change = np.maximum(*(most[end] for end in ends)) - np.minimum(*(least[end] for end in ends))
        found[some] = change.max(axis=1)
        behind = np.minimum(np.arange(BINS + 1) + (1 << doubling), BINS)
        least, most = np.minimum(least, least[behind]), np.maximum(most, most[behind])
    return found


def _grown(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return blocks that are set or beside one that is, across faces, edges or corners."""
    found = flags.copy()
    for axis in range(3):
        one = np.moveaxis(found, axis, 0)
        before = one.copy()
        one[1:] |= before[:-1]
        one[:-1] |= before[1:]
    return found
