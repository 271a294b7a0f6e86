"""Differences of each component to the pixel before.

What: a rearrangement of values, for `lz4` after it: slopes become equal small numbers. Floats are subtracted as the
integers that their bits are, which grow with them, so that nothing is rounded; the sign goes into the lowest bit.
When: before `lz4`, on smooth 8-bit images; before `shuffle+lz4`, on smooth float images.
When not: noise; floats without `shuffle` behind it, whose lowest bytes are noise to LZ4.
Cost: one pass, at memory speed. Limits: none.
Reference: the Sub filter of PNG, ISO/IEC 15948:2004, 9.2.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.codec.contract import Bytes


def apply(source: Bytes, target: Bytes, dtype: np.dtype[Any]) -> None:
    """Subtract."""
    from clusterviz.codec import difference_kernels

    bits = np.dtype(f"i{dtype.itemsize}")
    difference_kernels.subtract(source.view(bits), target.view(bits))


def undo(source: Bytes, target: Bytes, dtype: np.dtype[Any]) -> None:
    """Add up."""
    from clusterviz.codec import difference_kernels

    difference_kernels.add(source, 8 * dtype.itemsize, target)
