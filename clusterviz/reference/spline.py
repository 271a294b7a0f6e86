"""Reference cubic B-splines in float64: field and gradient from 4 × 4 × 4 voxels.

References
----------
C. Sigg, M. Hadwiger: Fast third-order texture filtering, GPU Gems 2, 2005, chapter 20 (the weights).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.reference.rays import Floats
from clusterviz.reference.sample import Flags, trilinear_cell


def cubic(voxels: NDArray[Any], x: Floats, y: Floats, z: Floats) -> tuple[Floats, Flags]:
    """Return the field of cubic B-splines with the voxels as coefficients; parameters and result as in `trilinear`.

    A voxel beyond the volume is replaced by its neighbour in it, and an invalid one that is not a corner of the cell by
    the corner next to it. If a corner is invalid, the point has no scalar.
    """
    taps, fraction, valid = _taps(voxels, np.stack([x, y, z], axis=1))
    along = [_weights(t) for t in fraction.T]
    apart, base, factor = _apart(taps)
    sums = np.einsum("nzyx,nx,ny,nz->n", apart, *along)
    return np.where(valid, factor * (base + sums), 0), valid


def cubic_gradient(voxels: NDArray[Any], point: Floats) -> Floats:
    """Return the gradient of the field, float64 (n, 3), per voxel along (x, y, z); undefined where it has no scalar."""
    taps, fraction, _ = _taps(voxels, point)
    apart, _, factor = _apart(taps)
    along, slopes = [_weights(t) for t in fraction.T], [_slopes(t) for t in fraction.T]
    gradient = np.zeros(point.shape)
    for axis in range(3):
        weights = [slopes[a] if a == axis else along[a] for a in range(3)]
        gradient[:, axis] = factor * np.einsum("nzyx,nx,ny,nz->n", apart, *weights)
    return gradient


def _taps(voxels: NDArray[Any], point: Floats) -> tuple[Floats, Floats, Flags]:
    """Return voxels around points (n, 4, 4, 4) in (z, y, x), positions in the cells (n, 3), and which are valid."""
    cell, fraction = trilinear_cell(voxels, point)
    x, y, z = (
        np.clip(cell[:, axis, None] + np.arange(-1, 3), 0, samples - 1)
        for axis, samples in enumerate(voxels.shape[::-1])
    )
    taps = voxels[z[:, :, None, None], y[:, None, :, None], x[:, None, None, :]].astype(np.float64)
    valid: Flags = np.isfinite(taps[:, 1:3, 1:3, 1:3]).all(axis=(1, 2, 3))
    if not np.isfinite(taps).all():
        corner = np.array([1, 1, 2, 2])
        corners = taps[:, corner[:, None, None], corner[:, None], corner]
        taps = np.where(np.isfinite(taps), taps, np.where(np.isfinite(corners), corners, 0))
    return taps, fraction, valid


def _apart(taps: Floats) -> tuple[Floats, Floats, float]:
    """Return voxels minus a corner, so that a constant field stays constant; the corner; and the scale of both.

    The scale is 1, and more where differences overflow.
    """
    for factor in (1.0, 4.0):
        base = taps[:, 1, 1, 1] / factor
        with np.errstate(over="ignore", invalid="ignore"):
            apart = taps / factor - base[:, None, None, None]
        if np.isfinite(apart).all():
            break
    return apart, base, factor


def _weights(t: Floats) -> Floats:
    """Return the weights of the four B-splines in a cell, (n, 4)."""
    weights = [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]
    return np.stack(weights, axis=1) / 6


def _slopes(t: Floats) -> Floats:
    """Return the derivatives of the weights."""
    slopes = [-3 * (1 - t) ** 2, 9 * t**2 - 12 * t, -9 * t**2 + 6 * t + 3, 3 * t**2]
    return np.stack(slopes, axis=1) / 6
