"""Difference of two pictures, as `verify`, the tests and the trade-off report measure it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError


@dataclass(frozen=True)
class Difference:
    """Difference of two pictures, in their own unit (0…1 for floats, levels for bytes).

    Attributes
    ----------
    max : largest absolute difference of any channel; inf if a value of either picture is NaN or infinite
    rms : root of the mean square over all pixels and channels; inf likewise
    tolerance : a pixel is wrong if one of its channels differs by more than this, or is not finite
    count : number of wrong pixels
    first_wrong_pixel : (row, column) of the topmost, then leftmost of them; None if there is none
    """

    max: float
    rms: float
    tolerance: float
    count: int
    first_wrong_pixel: tuple[int, int] | None

    def __str__(self) -> str:
        """Return one line: max, rms, and the position of the first wrong pixel."""
        text = f"max {self.max:.3g}, rms {self.rms:.3g}"
        if self.first_wrong_pixel is None:
            return f"{text}, no pixel above {self.tolerance:.3g}"
        row, column = self.first_wrong_pixel
        pixels = "pixel" if self.count == 1 else "pixels"
        return f"{text}, {self.count} {pixels} above {self.tolerance:.3g}, the first at row {row}, column {column}"


def compare(a: NDArray[Any], b: NDArray[Any], tolerance: float = 0.0) -> Difference:
    """Measure the difference of two pictures in float64.

    Parameters
    ----------
    a, b : (h, w) or (h, w, channels), same shape; both floats or both integers
    tolerance : largest difference that still counts as equal, in the pictures' unit

    Raises
    ------
    InputError
        Shapes differ, or one picture holds bytes and the other floats.
    """
    if a.shape != b.shape or a.ndim not in (2, 3):
        raise InputError("pictures of different shape", where="compare", found=f"{a.shape} and {b.shape}")
    if (a.dtype.kind == "f") != (b.dtype.kind == "f"):
        raise InputError("pictures of different units", where="compare", found=f"{a.dtype} and {b.dtype}")
    if a.size == 0:
        return Difference(0.0, 0.0, tolerance, 0, None)
    with np.errstate(invalid="ignore"):
        error = np.subtract(a, b, dtype=np.float64).reshape(*a.shape[:2], -1)
    np.abs(error, out=error)
    error[~np.isfinite(error)] = np.inf
    wrong = np.flatnonzero((error > tolerance).any(axis=-1) | np.isinf(error).any(axis=-1))
    first = divmod(int(wrong[0]), a.shape[1]) if wrong.size else None
    largest = float(error.max())
    # Scaling by the largest avoids underflow and overflow of the squares.
    scale = largest if 0 < largest < math.inf else 1.0
    rms = scale * math.sqrt(float(np.mean(np.square(error / scale))))
    return Difference(largest, rms, tolerance, int(wrong.size), first)
