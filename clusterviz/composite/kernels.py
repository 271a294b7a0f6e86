"""The over operator at memory speed: numba kernels, imported only where something is blended.

`source` holds n pixels; the other arguments say where they go in `target`: run k of `length` pixels starts at
`start` + k·`stride`, the first run leaves out its first `skip` pixels, and the last ends where the source ends. Each
kernel is written out, because its inner loop must be plain to be vectorised.

Bytes are blended two channels at once in a 32-bit word. A product of two bytes is at most 65,025, and its division by
255 rounded to nearest is (x + 128 + ((x + 128) >> 8)) >> 8, all within 16 bits. A sum above 255, which premultiplied
pixels cannot give, is cut to 255, so that wrong input stays wrong in its own channel.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Words = NDArray[np.uint32]

_LOW = np.uint32(0x00FF00FF)
_HALF = np.uint32(0x00800080)
_CARRY = np.uint32(0x00010001)
_FULL = np.uint32(255)
_8 = np.uint32(8)
_24 = np.uint32(24)


@numba.njit(cache=True, nogil=True, inline="always")
def _over_word(front, back):  # type: ignore[no-untyped-def]
    """One uint8 pixel over another, as little-endian words with alpha on top."""
    rest = _FULL - (front >> _24)
    even = (back & _LOW) * rest + _HALF
    odd = ((back >> _8) & _LOW) * rest + _HALF
    even = (front & _LOW) + (((even + ((even >> _8) & _LOW)) >> _8) & _LOW)
    odd = ((front >> _8) & _LOW) + (((odd + ((odd >> _8) & _LOW)) >> _8) & _LOW)
    over = (even >> _8) & _CARRY
    even = (even | ((over << _8) - over)) & _LOW
    over = (odd >> _8) & _CARRY
    odd = (odd | ((over << _8) - over)) & _LOW
    return even | (odd << _8)


@numba.njit(cache=True, nogil=True)
def words_before(target: Words, source: Words, start: int, skip: int, length: int, stride: int) -> None:
    """target = source over target, uint8 pixels as words (n,)."""
    taken = 0
    while taken < source.size:
        count = min(length - skip, source.size - taken)
        back = target[start + skip : start + skip + count]
        front = source[taken : taken + count]
        for i in range(count):
            back[i] = _over_word(front[i], back[i])
        taken += count
        start += stride
        skip = 0


@numba.njit(cache=True, nogil=True)
def words_behind(target: Words, source: Words, start: int, skip: int, length: int, stride: int) -> None:
    """target = target over source, uint8 pixels as words (n,)."""
    taken = 0
    while taken < source.size:
        count = min(length - skip, source.size - taken)
        front = target[start + skip : start + skip + count]
        back = source[taken : taken + count]
        for i in range(count):
            front[i] = _over_word(front[i], back[i])
        taken += count
        start += stride
        skip = 0


@numba.njit(cache=True, nogil=True)
def floats_before(target: Float, source: Float, start: int, skip: int, length: int, stride: int) -> None:
    """target = source over target, float32 pixels (n, 4)."""
    one = np.float32(1)
    taken = 0
    while taken < source.shape[0]:
        count = min(length - skip, source.shape[0] - taken)
        back = target[start + skip : start + skip + count]
        front = source[taken : taken + count]
        for i in range(count):
            rest = one - front[i, 3]
            back[i, 0] = front[i, 0] + rest * back[i, 0]
            back[i, 1] = front[i, 1] + rest * back[i, 1]
            back[i, 2] = front[i, 2] + rest * back[i, 2]
            back[i, 3] = front[i, 3] + rest * back[i, 3]
        taken += count
        start += stride
        skip = 0


@numba.njit(cache=True, nogil=True)
def floats_behind(target: Float, source: Float, start: int, skip: int, length: int, stride: int) -> None:
    """target = target over source, float32 pixels (n, 4)."""
    one = np.float32(1)
    taken = 0
    while taken < source.shape[0]:
        count = min(length - skip, source.shape[0] - taken)
        front = target[start + skip : start + skip + count]
        back = source[taken : taken + count]
        for i in range(count):
            rest = one - front[i, 3]
            front[i, 0] += rest * back[i, 0]
            front[i, 1] += rest * back[i, 1]
            front[i, 2] += rest * back[i, 2]
            front[i, 3] += rest * back[i, 3]
        taken += count
        start += stride
        skip = 0
