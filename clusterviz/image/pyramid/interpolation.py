"""Pull-push interpolation: values at some pixels to a whole picture or grid, smooth in between, exact where given.

What: reductions of values times weights and of weights by box 4 × 4 up to a single pixel (pull); then from there
Doo-Sabin syntheses, which set only the pixels of a level that have no support (push).

When to use: many scattered values, at a cost that does not depend on their number, and holes in pictures. When not:
few values that are to be interpolated with high accuracy; radial basis functions are slower, and follow gradients,
while here the surroundings of a value tend to the mean of those nearby.

Cost: 2 fetches for each value and weight of a reduced pixel, 1 for each of a synthesized one, and a look at the pixel
itself: in all at most 8/3 for each pixel of a picture in the push, independent of its size.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 4.2.2.
S. Gortler et al., The lumigraph, SIGGRAPH 1996.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.image.pyramid.executor import LARGEST, Fetches, Floats, apply_filter, check_image
from clusterviz.image.pyramid.filters import BOX_4, DOO_SABIN


def interpolate(values: Floats, weights: NDArray[Any], fetches: Fetches | None = None) -> Floats:
    """Return values for all pixels of a picture or a grid from those that are given.

    Parameters
    ----------
    values : float32 (h, w, c) or (d, h, w, c); colours premultiplied by their opacity
    weights : bool or float32 (h, w) or (d, h, w), at least 0: the support of each pixel. Where it is 0, or a value is
        NaN, infinite or beyond 4e37, no value is given.
    fetches : counts those of the push, and of the pull those of the values

    Returns
    -------
    values : float32, of the same shape
        Where values are given these, elsewhere between the least and the largest one up to rounding. Without any, 0.

    Raises
    ------
    InputError
        The values are no image, or the weights have another shape, or are negative or not finite.
    """
    pixels = check_image(values)
    if weights.shape != pixels.shape[:-1] or not (np.isfinite(weights) & (weights >= 0)).all():
        found = f"{weights.dtype} {weights.shape}, least {weights.min() if weights.size else 'none'}"
        raise InputError("wrong weights", where="interpolate", found=found, allowed=f"{pixels.shape[:-1]}, 0 or more")
    is_given = (np.abs(pixels) <= LARGEST).all(axis=-1) & (weights > 0)
    if not is_given.any():
        return np.zeros_like(pixels)
    support = np.where(is_given, weights, 0)[..., None].astype(np.float32)
    known: Floats = np.where(is_given[..., None], pixels, np.float32(0))
    scale: Floats = np.abs(known).max(axis=tuple(range(known.ndim - 1)))  # products of tiny values keep their digits
    scale[scale == 0] = 1
    image = _push(_pull(known / scale * support, support, fetches), fetches) * scale
    image[is_given] = pixels[is_given]
    return image


def _pull(products: Floats, support: Floats, fetches: Fetches | None) -> list[tuple[Floats, Floats]]:
    """Return products of values and weights, and weights, of all levels, the finest first."""
    levels = [(products, support)]
    while max(support.shape) > 1:
        products = apply_filter(BOX_4, products, fetches=fetches)
        support = apply_filter(BOX_4, support)
        levels.append((products, support))
    return levels


def _push(levels: list[tuple[Floats, Floats]], fetches: Fetches | None) -> Floats:
    (products, support), *finer = reversed(levels)
    image: Floats = products / support
    for products, support in finer:
        image = apply_filter(DOO_SABIN, image, support.shape[:-1], fetches)
        np.divide(products, support, out=image, where=support > 0)
        if fetches is not None:
            fetches.count += math.prod(support.shape)
    return image
