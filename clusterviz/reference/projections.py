"""Reference of projections: maximum, minimum, local maximum, first hit, average, sum, two fluxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.volume.optics import optical_function
from clusterviz.reference.rays import Floats
from clusterviz.reference.transfer import TransferFunction
from clusterviz.reference.two_flux import TwoFlux
from clusterviz.scene.background import RGB
from clusterviz.scene.values import Volume

Flags = NDArray[np.bool_]


class Extreme:
    """Maximum and minimum: colour and opacity of the ray's largest or smallest scalar.

    `rays`: number of rays; `sign`: 1 for the largest, −1 for the smallest.
    """

    def __init__(self, rays: int, sign: int) -> None:
        self.sign, self.found = sign, np.full(rays, -np.inf)

    def take(self, rays: NDArray[np.int64], scalar: Floats, valid: Flags, _: Floats) -> None:
        """Add the next samples of rays."""
        self.found[rays] = np.maximum(self.found[rays], np.where(valid, self.sign * scalar, -np.inf))

    def finish(self, classify: TransferFunction) -> Floats:
        return _classified(self.sign * self.found, np.isfinite(self.found), classify)


class LocalMaximum:
    """The largest scalar of the ray's first run of samples not below a threshold, else of the whole ray."""

    def __init__(self, rays: int, threshold: float) -> None:
        self.threshold = threshold
        self.largest, self.first = np.full(rays, -np.inf), np.full(rays, -np.inf)
        self.ended = np.zeros(rays, bool)

    def take(self, rays: NDArray[np.int64], scalar: Floats, valid: Flags, _: Floats) -> None:
        """Add the next samples of rays; invalid ones are ignored."""
        rays, scalar = rays[valid], scalar[valid]
        self.largest[rays] = np.maximum(self.largest[rays], scalar)
        above = scalar >= self.threshold
        self.ended[rays] |= ~above & (self.first[rays] > -np.inf)
        grows = above & ~self.ended[rays]
        self.first[rays[grows]] = np.maximum(self.first[rays[grows]], scalar[grows])

    def finish(self, classify: TransferFunction) -> Floats:
        scalar = np.where(self.first > -np.inf, self.first, self.largest)
        return _classified(scalar, np.isfinite(scalar), classify)


class FirstHit:
    """The ray's first scalar not below a threshold."""

    def __init__(self, rays: int, threshold: float) -> None:
        self.threshold, self.found = threshold, np.full(rays, np.nan)

    def take(self, rays: NDArray[np.int64], scalar: Floats, valid: Flags, _: Floats) -> None:
        """Add the next samples of rays."""
        hit = valid & (scalar >= self.threshold) & np.isnan(self.found[rays])
        self.found[rays[hit]] = scalar[hit]

    def finish(self, classify: TransferFunction) -> Floats:
        return _classified(self.found, ~np.isnan(self.found), classify)


class Sum:
    """Average and sum of opacity × scalar, in grey.

    `rays`: number of rays. `classify`: transfer function; scalars are clamped to its domain and scaled to 0 … 1.
    `divisor`: None for the mean over the ray's length in valid voxels, or the length that counts as 1.
    """

    def __init__(self, rays: int, classify: TransferFunction, divisor: float | None) -> None:
        self.classify, self.divisor = classify, divisor
        self.total, self.way = np.zeros(rays), np.zeros(rays)

    def take(self, rays: NDArray[np.int64], scalar: Floats, valid: Flags, length: Floats) -> None:
        """Add the next samples of rays."""
        share = np.clip(_share(scalar, *self.classify.domain), 0, 1)
        self.total[rays] += np.where(valid, self.classify.opacity(scalar) * share * length, 0)
        self.way[rays] += np.where(valid, length, 0)

    def finish(self, _: TransferFunction) -> Floats:
        """Return rgba, float64 (rays, 4); opaque where the ray met valid voxels."""
        hit = self.way > 0
        grey = self.total / np.where(hit, self.way if self.divisor is None else self.divisor, 1)
        rgba = np.repeat(np.clip(grey, 0, 1)[:, None], 4, axis=1)
        rgba[:, 3] = 1
        return np.where(hit[:, None], rgba, 0)


Projection = Extreme | LocalMaximum | FirstHit | Sum | TwoFlux


def projection_of(volume: Volume, rays: int, classify: TransferFunction, background: RGB = (1.0,) * 3) -> Projection:
    """Return the projection for a completed volume's blending, before a background that light passes to."""
    if volume.blending == "local-maximum":
        return LocalMaximum(rays, float(volume.threshold))  # type: ignore[arg-type]
    if volume.blending == "first-hit":
        return FirstHit(rays, float(volume.threshold))  # type: ignore[arg-type]
    if volume.optics is not None:
        return TwoFlux(rays, optical_function(volume.optics), background)
    if volume.blending in ("maximum", "minimum"):
        return Extreme(rays, 1 if volume.blending == "maximum" else -1)
    return Sum(rays, classify, None if volume.blending == "average" else classify.unit_distance)


def _share(scalar: Floats, low: float, high: float) -> Floats:
    """Return scalars in units of a range, scaled by a power of two so that nothing overflows."""
    exponent = -int(np.frexp([low, high])[1].max())
    with np.errstate(over="ignore"):  # of scalars far beyond the range
        scaled, begin, end = (np.ldexp(value, exponent) for value in (scalar, low, high))
    share: Floats = (scaled - begin) / (end - begin)
    return share


def _classified(scalar: Floats, known: Flags, classify: TransferFunction) -> Floats:
    """Return the premultiplied colour of scalars, with the opacity of the transfer function for any length."""
    scalar = np.where(known, scalar, 0)
    alpha = classify.opacity(scalar)[:, None]
    return np.where(known[:, None], np.append(classify.colour(scalar) * alpha, alpha, axis=1), 0)
