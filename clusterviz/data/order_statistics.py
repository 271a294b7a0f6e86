"""Exact order statistics of samples distributed over bricks and ranks, by radix selection with 16 bits a pass.

Samples become unsigned keys in the same order (float bits with the sign folded, integers with the sign bit flipped).
Counts of the leading 16 bits of all keys locate the bin of a wanted rank. Counts of the next 16 bits of the keys in
that bin narrow it, until the key is known. Counts are integers, so the result does not depend on bricks and ranks, and
outliers do not affect the precision.

References
----------
Knuth, The Art of Computer Programming, volume 3, section 5.2.5 (radix methods).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Keys = NDArray[Any]
Counts = NDArray[np.int64]

DIGIT_BITS = 16
DIGITS = 1 << DIGIT_BITS


def shifts_of(dtype: np.dtype[Any]) -> tuple[int, ...]:
    """Return the right shift of each digit of a key, leading digit first."""
    bits = 8 * dtype.itemsize
    return tuple(range(bits - DIGIT_BITS, -1, -DIGIT_BITS)) or (0,)


def keys_of(samples: NDArray[Any]) -> Keys:
    """Return unsigned keys, as wide as the samples and in the same order (−0 before +0)."""
    unsigned = np.dtype(f"u{samples.dtype.itemsize}")
    bits = samples.view(unsigned)
    sign = unsigned.type(1 << (8 * samples.dtype.itemsize - 1))
    if samples.dtype.kind == "f":
        negative = samples.view(f"i{samples.dtype.itemsize}") >> (8 * samples.dtype.itemsize - 1)  # all ones or none
        return np.asarray(bits ^ (negative.view(unsigned) | sign))
    return bits ^ sign if samples.dtype.kind == "i" else bits


def samples_of(keys: Keys, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the samples of keys, the inverse of `keys_of`, in place."""
    bits = 8 * dtype.itemsize
    sign = keys.dtype.type(1 << (bits - 1))
    if dtype.kind == "f":
        keys ^= ~(keys.view(f"i{dtype.itemsize}") >> (bits - 1)).view(keys.dtype) | sign
    elif dtype.kind == "i":
        keys ^= sign
    return keys.view(dtype)


def values_of(keys: Keys, dtype: np.dtype[Any]) -> NDArray[np.float64]:
    return samples_of(keys.astype(f"u{dtype.itemsize}"), dtype).astype(np.float64)


@dataclass(frozen=True)
class RadixSelection:
    """Ranks to select, each narrowed down to keys that begin with its prefix.

    Attributes
    ----------
    prefixes : uint64 (targets,), the leading digits found so far
    ranks : int64 (targets,), the wanted rank among the samples that begin with the prefix, from 0
    """

    prefixes: NDArray[np.uint64]
    ranks: NDArray[np.int64]

    @property
    def bins(self) -> NDArray[np.uint64]:
        """The distinct prefixes, in order: the rows of `count`."""
        return np.array(sorted(set(self.prefixes.tolist())), np.uint64)

    def narrow(self, counts: Counts) -> RadixSelection:
        """Return the selection narrowed by one digit, by its counts in each bin: int64 (bins, DIGITS)."""
        rows = np.searchsorted(self.bins, self.prefixes)
        below = np.cumsum(counts, axis=1)
        digits = [np.searchsorted(below[row], rank, side="right") for row, rank in zip(rows, self.ranks, strict=True)]
        skipped = [below[row, digit - 1] if digit else 0 for row, digit in zip(rows, digits, strict=True)]
        prefixes = (self.prefixes << np.uint64(DIGIT_BITS)) | np.array(digits, np.uint64)
        return RadixSelection(prefixes, self.ranks - np.array(skipped, np.int64))


def begin_selection(ranks: Sequence[int]) -> RadixSelection:
    return RadixSelection(np.zeros(len(ranks), np.uint64), np.array(ranks, np.int64))


def count(keys: Keys, bins: NDArray[np.uint64], shift: int) -> Counts:
    """Count one digit of the keys whose leading digits are one of `bins`.

    Returns
    -------
    counts : int64 (bins, DIGITS)
    """
    leading = shift + DIGIT_BITS
    if leading >= 8 * keys.dtype.itemsize:  # the first digit: no prefix yet
        digits = (keys >> keys.dtype.type(shift)).astype(np.intp, copy=False)
        return np.bincount(digits, minlength=DIGITS).astype(np.int64, copy=False)[None]
    top_shift = 8 * keys.dtype.itemsize - DIGIT_BITS
    meant = np.zeros(DIGITS, bool)
    meant[(bins >> np.uint64(top_shift - leading)).astype(np.intp)] = True
    keys = keys[meant[keys >> keys.dtype.type(top_shift)]]  # a table is faster than a search
    prefixes = keys >> keys.dtype.type(leading)
    rows = np.searchsorted(bins, prefixes)
    hit = bins[np.minimum(rows, len(bins) - 1)] == prefixes
    digits = ((keys[hit] >> keys.dtype.type(shift)) & keys.dtype.type(DIGITS - 1)).astype(np.intp)
    flat = np.bincount(rows[hit] * DIGITS + digits, minlength=len(bins) * DIGITS)
    return flat.astype(np.int64, copy=False).reshape(len(bins), DIGITS)
