"""Pre-integrated classification without a table: segments of the transfer function that a shader integrates.

If the scalar changes linearly along a slab, the integrals of emission and absorption are those of the transfer
function between two scalars. The function is piecewise linear, so κ is stored as a parabola for each segment, with
sums over whole segments. A slab then has three parts: a part of the first segment, all whole segments between, and a
part of the last one (ramp.glsl). If the segments between have an optical depth above 0.25, they are halved until the
next ones have less. There is no table of pairs of scalars, hence no resolution and no fixed length of a slab: a shorter
last slab is exact, and another step needs no new data.

The opacity of a slab is exact to float32. So is the mean of its colour and, nearly, the weight of its front; within a
part the colour is a line, which matters only if the part is both opaque and of many colours.

References
----------
S. Röttger, M. Kraus, T. Ertl: Hardware-accelerated volume and isosurface rendering based on cell-projection, IEEE
Visualization 2000 (pre-integration). K. Engel, M. Kraus, T. Ertl: High-quality pre-integrated volume rendering using
hardware-accelerated pixel shading, Graphics Hardware 2001, section 3.3 (integral functions, without self-attenuation).
E. Lum, B. Wilson, K.-L. Ma: High-quality lighting and efficient pre-integration for volume rendering, VisSym 2004.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.plan.segments import FAR, MOST_CUTS, Floats, Segments, halved, indexed, outline
from clusterviz.scene.transfer import OPAQUE, TransferFunction

# Relative and absolute error of κ in each segment, over one opacity unit distance.
PARABOLA_ERROR, PARABOLA_FLOOR = 5e-7, 1e-8
NODES = np.array([-0.4305681557970263, -0.16999052179242813, 0.16999052179242813, 0.4305681557970263])
WEIGHTS = np.array([0.17392742256872679, 0.3260725774312732, 0.3260725774312732, 0.17392742256872679])
"""Gauss-Legendre quadrature with four nodes, halved; written out, as importing numpy.polynomial is slow."""

SLAB_RECORD = np.dtype(
    [
        ("start", "f4"),
        ("end", "f4"),
        ("kappa", "f4", 3),  # κ = k₀ + k₁ x + k₂ x² over one opacity unit distance; x goes from 0 to 1 in the segment
        ("colour", "f4", 3),  # straight, at x = 0
        ("colour_change", "f4", 3),  # to x = 1
        ("per_scalar", "f4"),  # x per unit of the scalar; 0 in the constant segments at both ends
    ]
)
SUM_ROWS = 8  # ∫κ, ∫κc (3), ∫κcK (3) with K = ∫κ, all up to the start of a segment; one unused


def make_preintegrated(transfer: TransferFunction) -> Segments:
    """Cut a transfer function into segments for slabs of any length, with `sums`."""
    outlined, starts = outline(transfer)
    records = _refined(outlined)
    slabs = _parabolas(records)
    opaque = (records["unit_opacity"] > 0) | (records["unit_slope"] > 0)
    found = indexed(slabs, starts, opaque, SLAB_RECORD, segment_sums(slabs))
    if opaque.any() and records["unit_opacity"][np.argmax(opaque)] == 0:
        # Where opacity rises from 0, as often at the value of a background, that value is transparent, too.
        found = replace(
            found, transparent_below=float(np.nextafter(np.float32(found.transparent_below), np.float32(FAR)))
        )
    return found


def segment_sums(slabs: NDArray[np.void]) -> Floats:
    """Return integrals over the scalar, (n, SUM_ROWS), up to the start of each segment.

    They start at the segment nearest to 0, so that control points far from clim do not cost precision.
    """
    lengths = slabs["end"] - slabs["start"]
    lengths[[0, -1]] = 0.0
    x = NODES + 0.5
    kappa = slabs["kappa"] @ np.stack([np.ones(4), x, x * x])
    # Up to each node, from the segment's start.
    gathered = slabs["kappa"] @ np.stack([x, x**2 / 2, x**3 / 3]) * lengths[:, None]
    colour = slabs["colour"][:, None] + x[:, None] * slabs["colour_change"][:, None]
    weighted = (kappa * WEIGHTS * lengths[:, None])[..., None] * colour
    steps = np.zeros((len(slabs), SUM_ROWS))
    steps[:, 0] = (kappa @ WEIGHTS) * lengths
    steps[:, 1:4] = weighted.sum(axis=1)
    pivot = int(np.abs(slabs["start"]).argmin())
    sums = np.zeros(steps.shape)
    sums[:, :4] = _from_pivot(steps[:, :4], pivot)
    steps[:, 4:7] = (weighted * gathered[..., None]).sum(axis=1) + sums[:, :1] * steps[:, 1:4]
    sums[:, 4:7] = _from_pivot(steps[:, 4:7], pivot)
    return sums


def _from_pivot(steps: Floats, pivot: int) -> Floats:
    sums = np.zeros(steps.shape)
    sums[pivot + 1 :] = np.cumsum(steps[pivot:-1], axis=0)
    sums[:pivot] = -np.cumsum(steps[:pivot][::-1], axis=0)[::-1]
    return sums


def _kappa(records: NDArray[np.void], share: float) -> Floats:
    """Return κ over one opacity unit distance at a relative position in each segment."""
    lengths = np.append(np.diff(records["start"]), 0.0)
    lengths[0] = 0.0
    opacity = records["unit_opacity"] + records["unit_slope"] * lengths * share
    found: Floats = -np.log1p(-np.clip(opacity, 0.0, OPAQUE))
    return found


def _coefficients(records: NDArray[np.void]) -> Floats:
    """Return the parabola through κ at both ends and in the middle, (n, 3)."""
    begin, middle, end = (_kappa(records, share) for share in (0.0, 0.5, 1.0))
    return np.stack([begin, 4 * (middle - begin) - (end - begin), 2 * (begin - middle) + 2 * (end - middle)], axis=1)


def _refined(records: NDArray[np.void]) -> NDArray[np.void]:
    """Halve the inner segments until κ is a parabola to PARABOLA_ERROR."""
    while True:
        parabola, error = _coefficients(records), np.zeros(len(records))
        least = np.minimum(_kappa(records, 0.0), _kappa(records, 1.0))
        for share in (0.15, 0.3, 0.7, 0.85):
            found = parabola @ np.array([1.0, share, share * share])
            error = np.maximum(error, np.abs(found - _kappa(records, share)))
        middles = records["start"][:-1] + np.diff(records["start"]) / 2
        # Segments at the resolution of float32 are not cut further.
        apart = np.append(middles.astype(np.float32) > records["start"][:-1].astype(np.float32), False)
        cut = (error > PARABOLA_ERROR * least + PARABOLA_FLOOR) & apart
        if not cut.any() or len(records) > MOST_CUTS:
            return records
        records = halved(records, cut)


def _parabolas(records: NDArray[np.void]) -> NDArray[np.void]:
    """Return SLAB_RECORDs in float64."""
    slabs = np.zeros(len(records), [(name, "f8", SLAB_RECORD[name].shape) for name in SLAB_RECORD.names or ()])
    slabs["start"], slabs["end"] = records["start"], np.append(records["start"][1:], FAR)
    lengths = slabs["end"] - slabs["start"]
    slabs["kappa"], slabs["colour"] = _coefficients(records), records["colour"]
    slabs["per_scalar"][1:-1] = 1 / np.maximum(lengths[1:-1], 1e-30)
    slabs["colour_change"][1:-1] = records["colour_slope"][1:-1] * lengths[1:-1, None]
    return slabs
