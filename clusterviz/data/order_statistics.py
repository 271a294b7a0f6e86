"""Exact order statistics of samples that are spread over bricks and ranks: radix selection, 16 bits a pass.

Samples become unsigned keys in the same order (the bits of a float with its sign folded, an integer with its sign bit
turned). Counting the leading 16 bits of all keys tells in which bin a wanted rank lies; counting the next 16 bits of
the keys in that bin narrows it, until the key is known. Counts are integers, so neither bricks nor ranks show in the
result, and an outlier of 1e30 blurs nothing.

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
    """How far a key is shifted right to bring each of its digits down, leading digit first."""
    bits = 8 * dtype.itemsize
    return tuple(range(bits - DIGIT_BITS, -1, -DIGIT_BITS)) or (0,)


def keys_of(samples: NDArray[Any]) -> Keys:
    """Unsigned keys, as wide as the samples and ordered as they are (−0 before +0); `samples` is 1-D without NaN."""
    unsigned = np.dtype(f"u{samples.dtype.itemsize}")
    bits = samples.view(unsigned)
    sign = unsigned.type(1 << (8 * samples.dtype.itemsize - 1))
    if samples.dtype.kind == "f":
        negative = samples.view(f"i{samples.dtype.itemsize}") >> (8 * samples.dtype.itemsize - 1)  # all ones or none
        return np.asarray(bits ^ (negative.view(unsigned) | sign))
    return bits ^ sign if samples.dtype.kind == "i" else bits


def values_of(keys: Keys, dtype: np.dtype[Any]) -> NDArray[np.float64]:
    """The samples that `keys_of` made `keys` of, as float64."""
    unsigned = np.dtype(f"u{dtype.itemsize}")
    bits = keys.astype(unsigned)
    sign = unsigned.type(1 << (8 * dtype.itemsize - 1))
    if dtype.kind == "f":
        bits = np.where(bits & sign, bits ^ sign, ~bits)
    elif dtype.kind == "i":
        bits = bits ^ sign
    return bits.view(dtype).astype(np.float64)


@dataclass(frozen=True)
class RadixSelection:
    """Wanted ranks, each narrowed down to keys that begin with `prefixes`.

    Attributes
    ----------
    prefixes : uint64 (targets,), the leading digits found so far
    ranks : int64 (targets,), the wanted rank among the samples that begin with the prefix, from 0 on
    """

    prefixes: NDArray[np.uint64]
    ranks: NDArray[np.int64]

    @property
    def bins(self) -> NDArray[np.uint64]:
        """The distinct prefixes, in order: the rows that `count` counts."""
        return np.array(sorted(set(self.prefixes.tolist())), np.uint64)

    def narrow(self, counts: Counts) -> RadixSelection:
        """One digit further, by the counts of it in each bin: int64 (bins, DIGITS)."""
        rows = np.searchsorted(self.bins, self.prefixes)
        below = np.cumsum(counts, axis=1)
        digits = [np.searchsorted(below[row], rank, side="right") for row, rank in zip(rows, self.ranks, strict=True)]
        skipped = [below[row, digit - 1] if digit else 0 for row, digit in zip(rows, digits, strict=True)]
        prefixes = (self.prefixes << np.uint64(DIGIT_BITS)) | np.array(digits, np.uint64)
        return RadixSelection(prefixes, self.ranks - np.array(skipped, np.int64))


def begin_selection(ranks: Sequence[int]) -> RadixSelection:
    """The selection before anything is counted: every key may be meant."""
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
    keys = keys[meant[keys >> keys.dtype.type(top_shift)]]  # a table is far faster than a search
    prefixes = keys >> keys.dtype.type(leading)
    rows = np.searchsorted(bins, prefixes)
    hit = bins[np.minimum(rows, len(bins) - 1)] == prefixes
    digits = ((keys[hit] >> keys.dtype.type(shift)) & keys.dtype.type(DIGITS - 1)).astype(np.intp)
    flat = np.bincount(rows[hit] * DIGITS + digits, minlength=len(bins) * DIGITS)
    return flat.astype(np.int64, copy=False).reshape(len(bins), DIGITS)
