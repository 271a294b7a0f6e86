"""Structural similarity index (SSIM) of two pictures.

References
----------
Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli: Image quality assessment: from error visibility to structural
similarity, IEEE Transactions on Image Processing 13(4), 2004, section III.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SIDE, SIGMA = 11, 1.5  # the paper's window: a circular Gaussian, 11 × 11
K1, K2, RANGE = 0.01, 0.03, 1.0


def ssim(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Return the mean SSIM of two grey pictures.

    Parameters
    ----------
    a, b : (h, w), same shape, in [0, 1]

    Returns
    -------
    index : 1 for equal pictures; the mean over all positions of the window inside the picture, which is mirrored at its
        edges if it is smaller than the window
    """
    x, y = (_padded(np.asarray(picture, np.float64)) for picture in (a, b))
    mean_x, mean_y = _blur(x), _blur(y)
    # Rounding may give negative variances, which are 10⁻⁹ of c2.
    variance_x, variance_y = _blur(x * x) - mean_x**2, _blur(y * y) - mean_y**2
    covariance = _blur(x * y) - mean_x * mean_y
    c1, c2 = (K1 * RANGE) ** 2, (K2 * RANGE) ** 2
    above = (2 * mean_x * mean_y + c1) * (2 * covariance + c2)
    below = (mean_x**2 + mean_y**2 + c1) * (variance_x + variance_y + c2)
    return float(np.mean(above / below))


def luminance(rgb: NDArray[Any]) -> Floats:
    """Return luminance (h, w) of colours (h, w, 3) with the weights of ITU-R BT.601, as in the paper's program."""
    grey: Floats = np.asarray(rgb, np.float64) @ (0.299, 0.587, 0.114)
    return grey


def _blur(picture: Floats) -> Floats:
    """Return Gaussian weighted means over all windows inside the picture, by separable filters."""
    offset = np.arange(SIDE) - SIDE // 2
    weights = np.exp(-(offset**2) / (2 * SIGMA**2))
    weights /= weights.sum()
    for axis in (0, 1):
        picture = np.lib.stride_tricks.sliding_window_view(picture, SIDE, axis=axis) @ weights
    return picture


def _padded(picture: Floats) -> Floats:
    """Mirror a picture at its edges if it is smaller than the window."""
    if min(picture.shape) >= SIDE:
        return picture
    return np.pad(picture, SIDE // 2, mode="symmetric")
