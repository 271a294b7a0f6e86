"""Facts on content that every kind has, and boxes around it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Facts:
    """What every kind of content may say of an opened entry, with the answers of those that do not know.

    Attributes
    ----------
    smallest_spacing : of its samples, world units; 0 without samples
    orientation : directions of x, y and z of the data by the first letters of right, left, anterior, posterior,
        superior and inferior; else empty
    axes : the same, of a format that says what is up, for a scene that holds nothing else
    array : name of the array that is shown, if the section names none
    summary : what was done to open it, for statistics, in one line
    """

    orientation: str = ""
    axes: str = ""
    array: str = ""
    summary: str = ""

    @property
    def smallest_spacing(self) -> float:
        """Smallest distance of samples, world units; 0 without samples."""
        return 0.0


def box_corners(box: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the eight corners of a box (2, 3), float64 (8, 3), x fastest; none of no box (0, 3)."""
    return np.array(
        [[box[i, 0], box[j, 1], box[k, 2]] for k, j, i in np.ndindex(2, 2, 2)] if len(box) else np.empty((0, 3))
    )


def bounds(box: NDArray[np.float64]) -> list[list[float]]:
    """Return the low and high corner of a box as JSON; zeros of no box."""
    return np.asarray(box).tolist() if len(box) else [[0.0] * 3, [0.0] * 3]


def range_around(value: float) -> tuple[float, float]:
    """Return value ± 0.5, or value ± 2⁻²⁰ value if that is larger."""
    half = max(0.5, abs(value) * 2.0**-20)
    return max(value - half, -LARGEST), min(value + half, LARGEST)


LARGEST = float(np.finfo(np.float64).max)
