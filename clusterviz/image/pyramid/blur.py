"""Pyramidal blur of any width, at a cost that is linear in the pixels and does not grow with the width.

What: l reductions by the quadratic filter, n pairs of box filters of opposite shifts on the coarsest level, and l
Doo-Sabin syntheses. Along each axis a level adds 3/2 · 4^level to the variance, 3/4 by its reduction and 3/4 by its
synthesis, and the pairs, of masks [1 − d, d] and [d, 1 − d], 2 n d (1 − d) · 4^l. With d from 0 to 1/2 any variance is
met, so that the width varies continuously, and the standard deviation of the weights around each pixel, away from the
border, is the one that is asked for up to rounding.

How near to a Gaussian, along each axis: from a standard deviation of 1 on, weights differ by at most 9 % of the largest
one, and by 7 % in sum of magnitudes; below it, where the mask has few pixels, by 11 % and 17 %. The weights of a plane
are products of those of two axes: from 1 on they differ by at most 15 %, and by 10 % in sum.

When to use: wide blurs, glows, depth of field. When not: small ones that are to be exact to more than that; there
`Smooth` of `examples/jobs/volume_filters.py` convolves.

Cost: 1 + (4 + 1) / 3 fetches a pixel, and those of the pairs, 14 / 4^l at most: the most at standard deviations between
1.6 and 1.9, before the first reduction.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 4.2.1.
M. Kraus, Quasi-convolution pyramidal blurring, GRAPP 2009: smoother levels, and continuous widths.
"""

from __future__ import annotations

import math

import numpy as np

from clusterviz.errors import InputError
from clusterviz.image.pyramid.contract import Filter, Pass
from clusterviz.image.pyramid.executor import LARGEST, Fetches, Floats, apply_filter, check_image
from clusterviz.image.pyramid.filters import DOO_SABIN, QUADRATIC_4

MOST_SIGMA = 1e6
LEAST_ON_TOP = 0.5
"""Variance of the pairs at least, in pixels of the coarsest level; less shows the pattern of its pixels."""
PAIR = 0.5
"""Variance of a pair at most."""


def blur(image: Floats, sigma: float, fetches: Fetches | None = None) -> Floats:
    """Return a blurred image.

    Parameters
    ----------
    image : float32 (h, w, c), c channels that are blurred alike; colours premultiplied by their opacity, of any range
    sigma : standard deviation in pixels, 0 to 1e6; 0 leaves the image as it is

    Returns
    -------
    image : float32 (h, w, c)
        Beyond the border the nearest pixel counts. Pixels with a channel that is NaN, infinite or beyond 4e37 stay
        as they are, and have no influence on others.

    Raises
    ------
    InputError
        The image has another type or number of axes, or the standard deviation is impossible.
    """
    pixels = check_image(image)
    if not 0 <= sigma <= MOST_SIGMA:
        allowed = f"0 to {MOST_SIGMA:g} pixels"
        raise InputError("impossible standard deviation", where="blur", found=sigma, allowed=allowed)
    is_valid = (np.abs(pixels) <= LARGEST).all(axis=-1, keepdims=True)
    if is_valid.all():
        return _blurred(pixels, sigma, fetches)
    weights: Floats = _blurred(np.asarray(is_valid, np.float32), sigma, fetches)
    known: Floats = np.where(is_valid, pixels, np.float32(0))
    sums = _blurred(known, sigma, fetches)
    found: Floats = np.where(is_valid, sums / np.maximum(weights, np.float32(1e-30)), pixels)
    return found


def levels_of(sigma: float) -> tuple[int, float]:
    """Return the reductions for a standard deviation, and the variance that the coarsest level adds, in its pixels."""
    level, rest = 0, sigma**2
    while (coarser := (rest - 1.5) / 4) >= LEAST_ON_TOP:
        level, rest = level + 1, coarser
    return level, rest


def _blurred(image: Floats, sigma: float, fetches: Fetches | None) -> Floats:
    count, variance = levels_of(sigma)
    sizes = []
    for _ in range(count):
        sizes.append(image.shape[:-1])
        image = apply_filter(QUADRATIC_4, image, fetches=fetches)
    image = apply_filter(_pairs(variance), image, fetches=fetches)
    for size in reversed(sizes):
        image = apply_filter(DOO_SABIN, image, size, fetches)
    return image


def _pairs(variance: float) -> Filter:
    """Return pairs of box filters of opposite shifts that together add a variance along each axis."""
    count = math.ceil(variance / PAIR)
    shift = (1 - math.sqrt(max(0.0, 1 - 2 * variance / count))) / 2 if count else 0.0
    return Filter("pairs", (Pass("keep", -shift, more=1), Pass("keep", shift)) * count)
