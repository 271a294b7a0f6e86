"""The transfer function as the shader reads it: linear segments between control points, and buckets to find them.

Colour and opacity are linear between control points, but the opacity of a slab, 1 − (1 − α)^d, is not. Segments are cut
until the chord is exact to float32, so that the shader needs no logarithm per sample and there is no table resolution.
Steps in the function stay steps. Scalars are in units of clim (0 at its low end, 1 at its high end).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.encoding import in_units_of_clim
from clusterviz.scene.transfer import OPAQUE, TransferFunction, distinct, interpolate

BUCKETS = 4096
MOST_CUTS = 1 << 16
# Relative error of a slab's opacity, and absolute error per unit distance; the sum along a ray stays below 1e-6.
CHORD_ERROR, CHORD_FLOOR = 5e-7, 3e-8
FAR = float(np.finfo(np.float32).max)
Floats = NDArray[np.float64]

RECORD = np.dtype(
    [
        ("start", "f4"),  # the scalar where the segment starts
        ("slab_opacity", "f4"),  # of a whole slab, there
        ("slab_slope", "f4"),
        ("colour", "f4", 3),  # straight
        ("colour_slope", "f4", 3),
        ("unit_opacity", "f4"),  # over one opacity unit distance
        ("unit_slope", "f4"),
        ("region", "f4"),  # spectral: steps of the refractive index at or below it
    ]
)
BUCKET = np.dtype([("next_start", "f4"), ("first", "u4")])
NORMAL = 0x40000000
"""Added to `first`: shaders load a bucket as one float64, which is then a normal one, that no driver makes 0."""


@dataclass(frozen=True)
class Segments:
    """Piecewise-linear opacity and colour; a segment holds the scalars from its start to the next one's.

    Attributes
    ----------
    buckets : BUCKET (BUCKETS,): `NORMAL` and a segment that starts at or before each bucket, and the start
        of the next one
    low, per_unit : scalar at the start of bucket 0, and buckets per unit of the scalar
    sums : float64 (n, 8) for pre-integration, see `preintegration.py`; None for post-classification
    """

    records: NDArray[np.void]  # RECORD (n,), ascending starts
    buckets: NDArray[np.void]
    low: float
    per_unit: float
    further_starts: int  # the largest stride (a power of two, or 0) of a search for later segments of one bucket
    transparent_below: float  # scalar below which everything is transparent
    sums: NDArray[np.float64] | None = None


def make_segments(transfer: TransferFunction, slab_units: float) -> Segments:
    """Cut a transfer function into segments, with constant ones before the first control point and after the last.

    `slab_units`: length of a slab in opacity unit distances.
    """
    records, starts = outline(transfer)
    records = _refined(records, slab_units)
    return indexed(records, starts, (records["unit_opacity"] > 0) | (records["unit_slope"] > 0), RECORD)


def outline(transfer: TransferFunction) -> tuple[NDArray[np.void], Floats]:
    """Return the segments between all control points, uncut.

    Returns
    -------
    records : as `RECORD`, but float64; the fields of slabs are not set
    starts : float64 (n,), the control points
    """
    knots = distinct(transfer.opacity_values, transfer.colour_values)
    starts = np.clip(in_units_of_clim(knots, *transfer.domain), -FAR, FAR)
    records = np.zeros(len(knots) + 1, RECORD).astype([(name, "f8", RECORD[name].shape) for name in RECORD.names or ()])
    records["start"] = np.append(-FAR, starts)
    for name, values, results in (
        ("unit", transfer.opacity_values, transfer.opacities[:, None]),
        ("colour", transfer.colour_values, transfer.colours),
    ):
        at_start, slope = _pieces(knots, starts, values, results)
        opacity = name == "unit"
        records["unit_opacity" if opacity else "colour"] = at_start[:, 0] if opacity else at_start
        records[f"{name}_slope"] = slope[:, 0] if opacity else slope
    return records, starts


def _pieces(knots: Floats, starts: Floats, values: Floats, results: Floats) -> tuple[Floats, Floats]:
    """Return value (n, c) at the start of each segment and slope (n, c), including the constant outer segments."""
    after = interpolate(knots, values, results)
    # Mirrored, so that of two equal control points the earlier one counts: the limit from below.
    before = interpolate(-knots, -values[::-1], results[::-1])
    lengths = np.maximum(np.diff(starts), 1e-30)[:, None]
    flat = np.zeros((1, results.shape[1]))
    slopes = np.concatenate([flat, np.clip((before[1:] - after[:-1]) / lengths, -FAR, FAR), flat])
    return np.concatenate([before[:1], after]), slopes


def _refined(records: NDArray[np.void], slab_units: float) -> NDArray[np.void]:
    """Halve the inner segments until the chord of a slab's opacity is exact to CHORD_ERROR."""

    def slab(alpha: Floats) -> Floats:
        opacity: Floats = -np.expm1(slab_units * np.log1p(-np.clip(alpha, 0.0, OPAQUE)))
        return opacity

    while True:
        lengths = np.append(np.diff(records["start"]), 0.0)
        lengths[0] = 0.0
        ends = records["unit_opacity"] + records["unit_slope"] * lengths
        at_start, at_end = slab(records["unit_opacity"]), slab(ends)
        error = np.zeros(len(records))
        allowed = CHORD_ERROR * np.minimum(at_start, at_end) + CHORD_FLOOR * min(1.0, slab_units)
        for share in (0.25, 0.5, 0.75):
            inside = slab(records["unit_opacity"] + share * (ends - records["unit_opacity"]))
            error = np.maximum(error, np.abs(inside - (at_start + share * (at_end - at_start))))
        # Segments at the resolution of float32 are not cut further.
        middles = records["start"] + lengths / 2
        cut = (error > allowed) & (middles.astype(np.float32) > records["start"].astype(np.float32))
        if not cut.any() or len(records) > MOST_CUTS:
            records["slab_opacity"] = at_start
            records["slab_slope"] = (at_end - at_start) / np.maximum(lengths, 1e-30)
            return records
        records = halved(records, cut)


def halved(records: NDArray[np.void], cut: NDArray[np.bool_]) -> NDArray[np.void]:
    """Return the records with those to be cut divided in the middle; the last one is never cut."""
    lengths = np.diff(records["start"])[cut[:-1]]
    halves = records[cut].copy()
    halves["start"] += lengths / 2
    for name, slope in (("unit_opacity", "unit_slope"), ("colour", "colour_slope")):
        shift = (lengths / 2).reshape(-1, *[1] * (halves[name].ndim - 1))
        halves[name] += halves[slope] * shift
    return np.insert(records, np.flatnonzero(cut) + 1, halves)


def indexed(
    records: NDArray[np.void],
    starts: Floats,
    opaque: NDArray[np.bool_],
    dtype: np.dtype[np.void],
    sums: Floats | None = None,
) -> Segments:
    """Return the records in float32, and buckets over the range of the control points.

    Parameters
    ----------
    records : float64; the first field is the start of the segment
    starts : the control points
    opaque : segments that are not transparent
    dtype : type of the stored records
    """
    with np.errstate(over="ignore"):
        stored = records.astype(dtype)
    for name in dtype.names or ():
        stored[name] = np.clip(stored[name], -FAR, FAR)
    low, width = float(starts[0]), max(float(starts[-1] - starts[0]), 1e-30)
    # Buckets overlap a little, for the rounding of the shader's division.
    margin = 0.01 * width / BUCKETS + 1e-6 * max(abs(low), abs(low + width))
    edges = low + width * np.arange(BUCKETS) / BUCKETS - margin
    buckets = np.zeros(BUCKETS, BUCKET)
    first = (np.searchsorted(stored["start"], edges, side="right") - 1).clip(0)
    buckets["first"] = NORMAL + first
    buckets["next_start"] = np.append(stored["start"], FAR)[first + 1]
    last = np.searchsorted(stored["start"], edges + width / BUCKETS + 2 * margin, side="right") - 1
    most = int((last - first).max())
    below = float(stored["start"][np.argmax(opaque)]) if opaque.any() else FAR
    further_starts = 1 << (most - 1).bit_length() >> 1 if most > 1 else 0
    return Segments(stored, buckets, low, BUCKETS / width, further_starts, below, sums)
