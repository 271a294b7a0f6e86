"""Delta filter: differences of each component to the previous pixel.

What: a rearrangement of values for `lz4`: gradients become equal small numbers. The bit patterns of floats are
subtracted as integers, which increase with the values, so nothing is rounded. The sign goes into the lowest bit.
When: before `lz4`, on smooth 8-bit images; before `shuffle+lz4`, on smooth float images.
When not: noise; floats without `shuffle` after it, whose lowest bytes are noise to LZ4.
Cost: one pass, at memory speed. Limits: none.
Reference: the Sub filter of PNG, ISO/IEC 15948:2004, 9.2.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.codec import kernels
from clusterviz.codec.contract import Bytes


def apply(source: Bytes, target: Bytes, dtype: np.dtype[Any]) -> None:
    """Subtract the previous pixel."""
    bits = np.dtype(f"i{dtype.itemsize}")
    kernels.subtract[dtype.itemsize](source.view(bits), target.view(bits))


def undo(source: Bytes, target: Bytes, dtype: np.dtype[Any]) -> None:
    """Add up the differences."""
    kernels.add(source, 8 * dtype.itemsize, target)
