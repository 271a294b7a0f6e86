"""Radix sort of 32-bit keys by digits of 8 bits, compiled by numba.

An item has its key in the upper and its number in the lower half of 64 bits.
"""

from __future__ import annotations

from typing import Any

import numba

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_inline = numba.njit(inline="always", **_OPTIONS)


_u64 = numba.uint64  # of signed and unsigned numbers numba makes floats
_ONE, _BYTE = _u64(1), _u64(0xFF)


@_inline
def _ordered(bits, signed):  # type: ignore[no-untyped-def]
    """Return a whole number, uint64, in the order of float32, whose bits are given."""
    if signed:
        return _u64(bits ^ (numba.uint32(numba.int32(bits) >> 31) | numba.uint32(0x80000000)))
    return _u64(bits)


@_inline
def _put(item, value, shift, places, target):  # type: ignore[no-untyped-def]
    """Write a value to the next place of the item's digit."""
    digit = (item >> shift) & _BYTE
    place = places[digit]
    target[place] = value
    places[digit] = place + _ONE


def count_digits(keys, signed, counts):  # type: ignore[no-untyped-def]
    """Write the histograms of all four digits in one pass.

    `keys`: uint32 (n,); `signed`: 1 for the bits of float32, 0 for whole numbers; `counts`: int64 (4, 256), zeros.
    """
    a, b, c, d = counts[0], counts[1], counts[2], counts[3]
    for n in range(len(keys)):
        key = _ordered(keys[n], signed)
        a[key & _BYTE] += 1
        b[(key >> _u64(8)) & _BYTE] += 1
        c[(key >> _u64(16)) & _BYTE] += 1
        d[key >> _u64(24)] += 1


def count_digit(items, shift, counts):  # type: ignore[no-untyped-def]
    """Write the histogram of one digit.

    `items`: uint64 (n,); `shift`: bits below the digit; `counts`: int64 (256,), zeros.
    """
    shift = _u64(shift)
    for n in range(len(items)):
        counts[(items[n] >> shift) & _BYTE] += 1


def scatter_keys(keys, signed, first, shift, places, target):  # type: ignore[no-untyped-def]
    """Make items of keys, and write them in the order of a digit.

    `first`: number of the first key. `places`: uint64 (256,), the next place of each digit; raised. `target`: uint64
    (whole,).
    """
    shift = _u64(shift)
    for n in range(len(keys)):
        item = (_ordered(keys[n], signed) << _u64(32)) | _u64(first + n)
        _put(item, item, shift, places, target)


def scatter_items(items, shift, places, target):  # type: ignore[no-untyped-def]
    """Write items in the order of a digit; parameters as of `scatter_keys`."""
    shift = _u64(shift)
    for n in range(len(items)):
        _put(items[n], items[n], shift, places, target)


def scatter_numbers(items, shift, places, target):  # type: ignore[no-untyped-def]
    """Write the numbers of items in the order of a digit. `target`: uint32 (whole,)."""
    shift = _u64(shift)
    for n in range(len(items)):
        _put(items[n], numba.uint32(items[n]), shift, places, target)
