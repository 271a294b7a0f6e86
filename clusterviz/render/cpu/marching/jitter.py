"""Lattices of slabs that begin elsewhere in every pixel: the twin of jitter.glsl."""

from __future__ import annotations

from clusterviz.kernels.code import Code
from clusterviz.kernels.lanes import F64, I32, Value

# As signed numbers.
FACTORS = (0x7FEB352D, 0x846CA68B - (1 << 32))
DIGITS = 24


def shift_of(code: Code, x: Value, y: Value) -> Value:
    """By what share of a slab, float64 in [0, 1), the first one begins before the volume, for pixels of the picture.

    References
    ----------
    C. Wellons: Prospecting for hash functions, 2018 (lowbias32).
    """
    return (_hashed(_hashed(x) + y) >> (32 - DIGITS)).to(F64) * code.same(F64, 2.0**-DIGITS)


def _hashed(x: Value) -> Value:
    assert x.element is I32, "the hash is one of 32 bits"
    x = (x ^ (x >> 16)) * FACTORS[0]
    x = (x ^ (x >> 15)) * FACTORS[1]
    return x ^ (x >> 16)
