"""Reference of pyramid filters in float64: convolutions with the masks that the thesis prints, not fetches.

All masks are outer products of a mask along each axis. Beyond the border the nearest pixel counts.

Reference: M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, sections
4.1 and 4.2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.reference.sample import interpolated

Doubles = NDArray[np.float64]
Mask = tuple[int, tuple[float, ...]]
"""Place of the first weight beside a pixel, and the weights, which are divided by their sum."""

BASIC: dict[str, Mask] = {"box": (0, (1, 1)), "bartlett": (-1, (1, 2, 1)), "gauss 5 x 5": (-2, (1, 4, 6, 4, 1))}
ANALYSIS: dict[str, Mask] = {  # beside pixel 2 r of the fine image
    "box 2 x 2": (0, (1, 1)),
    "box 4 x 4": (-1, (1, 1, 1, 1)),
    "bartlett 3 x 3": (0, (1, 2, 1)),
    "quadratic 4 x 4": (-1, (1, 3, 3, 1)),
    "cubic 5 x 5": (-1, (1, 4, 6, 4, 1)),
}
SYNTHESIS: dict[str, tuple[Mask, Mask]] = {  # of even and odd pixels, beside pixel r // 2 of the coarse image
    "nearest": ((0, (1,)), (0, (1,))),
    "midpoint": ((-1, (1, 1)), (0, (1,))),
    "doo-sabin": ((-1, (1, 3)), (0, (3, 1))),
    "cubic": ((-1, (1, 1)), (-1, (1, 6, 1))),
}


def convolve(name: str, image: Doubles, size: Sequence[int] | None = None) -> Doubles:
    """Return an image after a filter.

    `name`: in one of the tables above. `image`: float64 (h, w, c) or (d, h, w, c). `size`: of the result of a
    synthesis; default: twice that of the image.
    """
    found = np.asarray(image, np.float64)
    for axis in range(found.ndim - 1):
        side = found.shape[axis]
        if name in BASIC:
            found = _along(found, axis, BASIC[name], np.arange(side))
        elif name in ANALYSIS:
            found = _along(found, axis, ANALYSIS[name], 2 * np.arange((side + 1) // 2))
        else:
            fine = np.arange(2 * side if size is None else size[axis])
            both = [_along(found, axis, mask, fine // 2) for mask in SYNTHESIS[name]]
            is_odd = (fine % 2).reshape([-1 if a == axis else 1 for a in range(found.ndim)])
            found = np.where(is_odd, both[1], both[0])
    return found


def _along(image: Doubles, axis: int, mask: Mask, places: NDArray[np.int64]) -> Doubles:
    first, weights = mask
    taps = [np.clip(places + first + n, 0, image.shape[axis] - 1) for n in range(len(weights))]
    parts = [weight * np.take(image, tap, axis=axis) for weight, tap in zip(weights, taps, strict=True)]
    total: Doubles = sum(parts[1:], parts[0]) / sum(weights)
    return total


def gaussian(image: Doubles, sigma: float) -> Doubles:
    """Return an image, float64 (h, w, c), convolved with a Gaussian cut off at eight standard deviations."""
    reach = int(np.ceil(8 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    found = np.asarray(image, np.float64)
    for axis in range(2):
        found = _along(found, axis, (-reach, tuple(weights.tolist())), np.arange(found.shape[axis]))
    return found


def pull_push(values: Doubles, weights: Doubles) -> Doubles:
    """Return values everywhere from those that are given at some pixels.

    `values`: float64 (h, w, c) or (d, h, w, c). `weights`: float64 (h, w) or (d, h, w), the support of each pixel, 0:
    no value is given; not 0 everywhere. Returns float64, of the same shape.
    """
    support = weights[..., None]
    if values.shape[:-1] == (1,) * weights.ndim:
        return values
    products = [convolve("box 4 x 4", each) for each in (np.where(support > 0, values, 0) * support, support)]
    means = products[0] / np.where(products[1] > 0, products[1], 1)
    coarse = pull_push(means, products[1][..., 0])
    return np.where(support > 0, values, convolve("doo-sabin", coarse, weights.shape))


def edge_directed(image: Doubles, strength: float, farthest: float, noise: float) -> Doubles:
    """Return an image (h, w, c) of twice the size, by fetches moved away from edges; parameters as of `zoom`."""
    height, width = image.shape[:2]
    bright = image.mean(axis=-1, keepdims=True)
    row, column = ((np.arange(2 * side) + 0.5) / 2 - 0.5 for side in (height, width))
    row, column = np.meshgrid(row, column, indexing="ij")
    f = {(i, j): _bilinear(bright, row + i, column + j)[..., 0] for i in (-1, 0, 1) for j in (-1, 0, 1)}
    slope = np.stack([f[1, 0] - f[-1, 0], f[0, 1] - f[0, -1]]) / 2
    second = {axis: f[axis] + f[-axis[0], -axis[1]] - 2 * f[0, 0] for axis in ((1, 0), (0, 1), (1, 1))}
    mixed = (second[1, 1] - second[1, 0] - second[0, 1]) / 2
    hessian = np.array([[second[1, 0], mixed], [mixed, second[0, 1]]])
    steep = (slope**2).sum(axis=0)
    bend = np.einsum("ihw,ijhw,jhw->hw", slope, hessian, slope)
    way = -strength * bend / np.maximum(steep, 1e-30) ** 2 * slope
    length = np.sqrt((way**2).sum(axis=0))
    way *= steep / (steep + noise**2) * np.minimum(1, farthest / np.maximum(length, 1e-12))
    return _bilinear(image, row + way[0], column + way[1])


def _bilinear(image: Doubles, row: Doubles, column: Doubles) -> Doubles:
    places = np.stack([column.ravel(), row.ravel()], axis=1).clip(0, np.array(image.shape[1::-1]) - 1)
    return interpolated(image, places).reshape(*row.shape, -1)
