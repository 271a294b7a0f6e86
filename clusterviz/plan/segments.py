"""The transfer function as the shader reads it: linear segments between all control points, and buckets to find them.

No table resolution enters: opacity and colour are evaluated on the very segments that the scene gives. Scalars are in units
of clim (0 at its low end, 1 at its high end).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.scene.transfer import TransferFunction, interpolate

BUCKETS = 4096
FAR = float(np.finfo(np.float32).max)
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Segments:
    """Piecewise-linear opacity and colour; segment j holds the scalars [start, next start).

    Attributes
    ----------
    line : float32 (n, 4): start, opacity there (over one opacity unit distance), slope, start of the next segment
    colour : float32 (2 n, 4): straight colour at the start, and its slope, in turn
    first : int32 (BUCKETS,): a segment that starts at or before each bucket, and ends in it or behind
    most_starts : how many segments beyond the first one a scalar of a bucket may lie, at most
    low, per_unit : the scalar at the start of bucket 0, and buckets per unit of the scalar
    transparent_below : no scalar below this one has any opacity
    """

    line: NDArray[np.float32]
    colour: NDArray[np.float32]
    first: NDArray[np.int32]
    most_starts: int
    low: float
    per_unit: float
    transparent_below: float


def make_segments(transfer: TransferFunction) -> Segments:
    """Cut a transfer function at all of its control points; constant segments lie before the first and behind the last."""
    knots = np.unique(np.concatenate([transfer.opacity_values, transfer.colour_values]))
    starts = np.clip(in_units_of_clim(knots, *transfer.domain), -FAR, FAR)
    opacity, opacity_slope = _pieces(knots, starts, transfer.opacity_values, transfer.opacities[:, None])
    colour, colour_slope = _pieces(knots, starts, transfer.colour_values, transfer.colours)
    line = np.column_stack([np.append(-FAR, starts), opacity, opacity_slope, np.append(starts, FAR)])
    pairs = np.zeros((len(line), 2, 4))
    pairs[:, 0, :3], pairs[:, 1, :3] = colour, colour_slope

    line32 = line.astype(np.float32)
    width = max(float(starts[-1] - starts[0]), 1e-30)
    first = _buckets(line32[:, 0], float(starts[0]), width)
    opaque = (opacity[:, 0] > 0) | (opacity_slope[:, 0] > 0)
    return Segments(
        line32,
        pairs.reshape(-1, 4).astype(np.float32),
        first,
        int(np.diff(first, append=len(line32) - 1).max()),
        float(starts[0]),
        BUCKETS / width,
        float(line32[np.argmax(opaque), 0]) if opaque.any() else FAR,
    )


def _pieces(knots: Floats, starts: Floats, values: Floats, results: Floats) -> tuple[Floats, Floats]:
    """Value (n, c) at the start of each segment and slope (n, c) on it, the constant outer segments included."""
    after = interpolate(knots, values, results)
    # Mirrored, the later of two equal points is the earlier one: the limit from below.
    before = interpolate(-knots, -values[::-1], results[::-1])
    lengths = np.maximum(np.diff(starts), 1e-30)[:, None]
    flat = np.zeros((1, results.shape[1]))
    slopes = np.concatenate([flat, np.clip((before[1:] - after[:-1]) / lengths, -FAR, FAR), flat])
    return np.concatenate([before[:1], after]), slopes


def _buckets(starts: NDArray[np.float32], low: float, width: float) -> NDArray[np.int32]:
    """For each bucket the segment at its lower edge, less a margin for float32 rounding in the shader's division."""
    edges = low + width * (np.arange(BUCKETS) - 0.01) / BUCKETS - 1e-6 * max(abs(low), abs(low + width))
    return (np.searchsorted(starts, edges, side="right") - 1).clip(0).astype(np.int32)
