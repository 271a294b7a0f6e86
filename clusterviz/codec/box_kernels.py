"""Finding the box of pixels that are not blank, on their marks."""

from __future__ import annotations

from numba import uint64

from clusterviz.codec.compiled import compiled, high_zeros, low_zeros

_ALL = uint64(0xFFFFFFFFFFFFFFFF)


@compiled
def _first(marks, begin, end):  # type: ignore[no-untyped-def]
    """The first pixel of [begin, end) that is not blank; `end` where there is none."""
    word = begin // 64
    left = marks[word] & (_ALL << uint64(begin % 64)) if begin < end else uint64(0)
    while not left and (word + 1) * 64 < end:
        word += 1
        left = marks[word]
    return min(64 * word + low_zeros(left), end) if left else end


@compiled
def _last(marks, begin, end):  # type: ignore[no-untyped-def]
    """The last pixel of [begin, end) that is not blank; `begin` - 1 where there is none."""
    word = (end - 1) // 64
    left = marks[word] & (_ALL >> uint64(63 - (end - 1) % 64)) if begin < end else uint64(0)
    while not left and word * 64 > begin:
        word -= 1
        left = marks[word]
    return max(64 * word + 63 - high_zeros(left), begin - 1) if left else begin - 1


@compiled
def find_box(marks, count, first, width):  # type: ignore[no-untyped-def]
    """The smallest box of pixels that are not blank: top, bottom, left, right; the row of the first pixel is row 0."""
    begin = _first(marks, 0, count)
    if begin == count:
        return 0, 0, 0, 0
    end = _last(marks, 0, count) + 1
    top, bottom = (first + begin) // width, (first + end - 1) // width + 1
    left, right = width, 0
    for row in range(top, bottom):
        start = row * width - first
        # Only columns outside the box so far can change it.
        low, high = max(start, 0), min(start + left, count)
        if low < high:
            left = min(left, _first(marks, low, high) - start)
        low, high = max(start + right, 0), min(start + width, count)
        if low < high:
            right = max(right, _last(marks, low, high) - start + 1)
    return top, bottom, left, right
