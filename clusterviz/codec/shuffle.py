"""Byte planes: the first bytes of all numbers, then their second bytes, and so on.

What: a rearrangement, for `lz4` after it. Numbers of two or four bytes are taken apart; of bytes, the four components
of the pixels are. Neighbouring floats agree in sign, exponent and leading digits, so those planes hold long repeats.
When: before `lz4`, for floats always, for 8-bit images mostly.
When not: alone, since it saves nothing.
Cost: one pass, at memory speed. Limits: none.
Reference: F. Alted, "Why modern CPUs are starving and what can be done about it", Computing in Science & Engineering
12(2), 2010 (the shuffle filter of Blosc; HDF5 has the same).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clusterviz.codec.contract import Bytes


def apply(source: Bytes, target: Bytes, dtype: np.dtype[Any]) -> None:
    """Take the pixels apart."""
    from clusterviz.codec import byte_kernels

    byte_kernels.split_planes(source, _planes(dtype), target)


def undo(source: Bytes, target: Bytes, dtype: np.dtype[Any]) -> None:
    """Put them together."""
    from clusterviz.codec import byte_kernels

    byte_kernels.join_planes(source, _planes(dtype), target)


def _planes(dtype: np.dtype[Any]) -> int:
    return dtype.itemsize if dtype.itemsize > 1 else 4
