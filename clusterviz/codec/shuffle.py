"""Shuffle filter: byte planes, the first bytes of all pixels, then their second bytes, and so on.

What: a rearrangement for `lz4`, into four, eight or sixteen planes, as many as a pixel has bytes. Neighbours agree in
the signs, exponents and leading digits of each component, so these planes have long repeats.
When: before `lz4`, for floats always, for 8-bit images mostly.
When not: alone, since it saves nothing.
Cost: one pass, at memory speed. Limits: none.
Reference: F. Alted, "Why modern CPUs are starving and what can be done about it", Computing in Science & Engineering
12(2), 2010 (the shuffle filter of Blosc; HDF5 has the same).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.codec import kernels
from clusterviz.codec.contract import Bytes


def apply(source: Bytes, target: Bytes, dtype: np.dtype[Any]) -> None:
    """Split the pixels into byte planes."""
    kernels.split_planes(source, 4 * dtype.itemsize, target, _tile(dtype))


def undo(source: Bytes, target: Bytes, dtype: np.dtype[Any]) -> None:
    """Join the byte planes."""
    kernels.join_planes(source, 4 * dtype.itemsize, target, _tile(dtype))


def _tile(dtype: np.dtype[Any]) -> Bytes:
    return np.empty(4 * dtype.itemsize * kernels.TILE, np.uint8)
