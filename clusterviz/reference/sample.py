"""Reference interpolation in float64: nearest, trilinear, and cubic B-splines with their gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


def trilinear(voxels: NDArray[Any], x: Floats, y: Floats, z: Floats) -> tuple[Floats, Flags]:
    """Interpolate linearly along x, then y, then z.

    A point belongs to the cell [floor, floor + 1) along each axis; the last cell includes its end. If one of the eight
    samples of the cell is NaN or infinite, the point has no scalar.

    `voxels`: (z, y, x), at least two samples along each axis, C order; `x`, `y`, `z`: (n,) positions in samples, inside
    the box. Returns `scalar`, float64 (n,), 0 where there is none; `valid`, bool (n,).
    """
    (nz, ny, nx), flat = voxels.shape, voxels.reshape(-1)
    i, fx = _cell(x, nx)
    j, fy = _cell(y, ny)
    k, fz = _cell(z, nz)
    first = (k * ny + j) * nx + i
    corners = np.empty((8, len(x)))
    for corner in range(8):
        dz, dy, dx = corner >> 2, corner >> 1 & 1, corner & 1
        corners[corner] = flat[first + ((dz * ny + dy) * nx + dx)]
    finite = np.isfinite(corners)
    valid = np.logical_and.reduce(finite)
    corners[~finite] = 0
    edges = _between(corners[0::2], corners[1::2], fx)
    faces = _between(edges[0::2], edges[1::2], fy)
    return np.where(valid, _between(faces[0], faces[1], fz), 0), valid


def nearest(voxels: NDArray[Any], x: Floats, y: Floats, z: Floats) -> tuple[Floats, Flags]:
    """Take the sample floor(position + 1/2); parameters and result as in `trilinear`."""
    (nz, ny, nx), flat = voxels.shape, voxels.reshape(-1)
    i, j, k = _round(x, nx), _round(y, ny), _round(z, nz)
    scalar = flat[(k * ny + j) * nx + i].astype(np.float64)
    valid: Flags = np.isfinite(scalar)
    return np.where(valid, scalar, 0), valid


def trilinear_cell(voxels: NDArray[Any], point: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the cells (n, 3) of points (n, 3), along (x, y, z), and the positions in them."""
    cells, fractions = zip(*(_cell(p, n) for p, n in zip(point.T, voxels.shape[::-1], strict=True)), strict=True)
    return np.stack(cells, axis=1), np.stack(fractions, axis=1)


def nearest_voxel(voxels: NDArray[Any], point: Floats) -> NDArray[np.int64]:
    """Return the nearest voxels (n, 3) of points (n, 3), along (x, y, z)."""
    return np.stack([_round(p, n) for p, n in zip(point.T, voxels.shape[::-1], strict=True)], axis=1)


def interpolated(samples: NDArray[Any], places: Floats) -> Floats:
    """Interpolate samples (…, y, x, *) linearly at places (n, k), along x, y, …: (n, *); outside as in a cell.

    Samples of weight 0 do not count, even if they are NaN.
    """
    count = places.shape[1]
    low, share = [], []
    for axis, side in enumerate(samples.shape[count - 1 :: -1]):
        with np.errstate(invalid="ignore"):
            cell = np.floor(np.where(np.isnan(places[:, axis]), 0, places[:, axis]))
        low.append(np.clip(cell, 0, max(side - 2, 0)).astype(int))
        share.append(places[:, axis] - low[-1])
    found = np.zeros((len(places), *samples.shape[count:]))
    for corner in np.ndindex(*(2,) * count):
        weight, at = np.ones(len(places)), []
        for axis, side in enumerate(samples.shape[count - 1 :: -1]):
            weight = weight * (share[axis] if corner[axis] else 1 - share[axis])
            at.append(np.minimum(low[axis] + corner[axis], side - 1))
        weight, values = weight.reshape(-1, *[1] * (samples.ndim - count)), samples[tuple(at[::-1])]
        found += np.where(weight == 0, 0, weight * values)
    return found


def _cell(position: Floats, samples: int) -> tuple[NDArray[np.int64], Floats]:
    cell = np.clip(np.floor(position), 0, samples - 2).astype(np.int64)
    # Rounding may put the ends of a ray an ulp outside the box.
    return cell, np.clip(position - cell, 0, 1)


def _round(position: Floats, samples: int) -> NDArray[np.int64]:
    return np.clip(np.floor(position + 0.5), 0, samples - 1).astype(np.int64)


def _between(a: Floats, b: Floats, fraction: Floats) -> Floats:
    """Return a + fraction · (b − a), exact for a constant field; the other form where b − a overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        scalar = a + fraction * (b - a)
    if np.isfinite(scalar).all():
        return scalar
    return np.where(np.isfinite(scalar), scalar, (1 - fraction) * a + fraction * b)


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
    weights = [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]
    return np.stack(weights, axis=1) / 6


def _slopes(t: Floats) -> Floats:
    slopes = [-3 * (1 - t) ** 2, 9 * t**2 - 12 * t, -9 * t**2 + 6 * t + 3, 3 * t**2]
    return np.stack(slopes, axis=1) / 6
