"""Faces of tetrahedra in buckets by their smallest corner, where those of two tetrahedra are found, compiled by numba.

A half-face is one of the four sides of a tetrahedron; its number is four times the tetrahedron's plus the place of the
corner that it does not have. In a bucket half-faces are sorted by their other two corners, then by their number.
"""

from __future__ import annotations

from typing import Any

import numba

NONE = 0xFFFFFFFF
SMALL = 48  # half-faces of a bucket that are sorted by insertion alone

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_inline = numba.njit(inline="always", **_OPTIONS)
_function = numba.njit(**_OPTIONS)


@_inline
def _corners(tetrahedra, row, k):  # type: ignore[no-untyped-def]
    """Return the corners of a half-face in increasing order, and 1 if it is clockwise in this order from outside."""
    p, q, r, s = tetrahedra[row, 0], tetrahedra[row, 1], tetrahedra[row, 2], tetrahedra[row, 3]
    a, b, c = q, r, s
    if k == 1:
        a, b, c = p, s, r
    elif k == 2:
        a, b, c = p, q, s
    elif k == 3:
        a, b, c = p, r, q
    odd = 0
    if a > b:
        a, b, odd = b, a, 1 - odd
    if b > c:
        b, c, odd = c, b, 1 - odd
    if a > b:
        a, b, odd = b, a, 1 - odd
    return a, b, c, odd


def count_half_faces(tetrahedra, counts):  # type: ignore[no-untyped-def]
    """Add the number of half-faces of each bucket.

    Parameters
    ----------
    tetrahedra : uint32 (m, 4), corners
    counts : int64 (n,), raised
    """
    for row in range(len(tetrahedra)):
        for k in range(4):
            counts[_corners(tetrahedra, row, k)[0]] += 1


def fill_buckets(tetrahedra, first, places, keys, numbers):  # type: ignore[no-untyped-def]
    """Put half-faces into their buckets.

    Parameters
    ----------
    first : number of the first of these tetrahedra
    places : int64 (n,), the next free place of each bucket; raised
    keys : uint64 (h,), the other two corners
    numbers : int64 (h,), twice the number of the half-face, plus 1 if it is clockwise
    """
    for row in range(len(tetrahedra)):
        for k in range(4):
            a, b, c, odd = _corners(tetrahedra, row, k)
            place = places[a]
            keys[place] = (b << 32) | c
            numbers[place] = 2 * (4 * (first + row) + k) + odd
            places[a] = place + 1


def match_half_faces(ends, first, last, keys, numbers, neighbours):  # type: ignore[no-untyped-def]
    """Sort the buckets [first, last), and find the other half-face of each face.

    Parameters
    ----------
    ends : int64 (n,), of the buckets
    neighbours : uint32 (h,), written

    Returns
    -------
    boundary, crowded : number of half-faces without another one, and of those that no side is free for
    """
    boundary, crowded = 0, 0
    for bucket in range(first, last):
        begin, end = ends[bucket - 1] if bucket else 0, ends[bucket]
        _sort(keys, numbers, begin, end)
        while begin < end:
            key, even, odd, run, odds = keys[begin], begin, begin, begin, 0
            while run < end and keys[run] == key:
                odds += numbers[run] & 1
                run += 1
            evens = run - begin - odds
            crowded += max(0, odds - 1) + max(0, evens - 1)
            boundary += abs(odds - evens)
            while True:  # the next even one beside the next odd one, as far as there are any
                while even < run and numbers[even] & 1:
                    even += 1
                while odd < run and not numbers[odd] & 1:
                    odd += 1
                if even >= run and odd >= run:
                    break
                if even < run:
                    neighbours[numbers[even] >> 1] = numbers[odd] >> 1 if odd < run else NONE
                if odd < run:
                    neighbours[numbers[odd] >> 1] = numbers[even] >> 1 if even < run else NONE
                even, odd = even + 1, odd + 1
            begin = run
    return boundary, crowded


def sort_corners(tetrahedra, corners, places):  # type: ignore[no-untyped-def]
    """Sort the corners of each tetrahedron.

    Parameters
    ----------
    corners : uint32 (m, 4), written
    places : uint8 (m, 4), of each corner, written
    """
    for row in range(len(tetrahedra)):
        for k in range(4):
            corner, place = tetrahedra[row, k], 0
            for other in range(4):
                place += tetrahedra[row, other] < corner
            corners[row, place] = corner
            places[row, k] = place


def sort_half_faces(neighbours, first, places, target):  # type: ignore[no-untyped-def]
    """Bring half-faces in the order of sorted corners, and their numbers to sorted corners.

    Parameters
    ----------
    neighbours : uint32 (k, 4), of some tetrahedra
    first : number of the first of them
    places : uint8 (m, 4), of all corners
    target : uint32 (k, 4), written
    """
    for row in range(len(neighbours)):
        for k in range(4):
            other = neighbours[row, k]
            if other != NONE:
                other = other - (other & 3) + places[other >> 2, other & 3]
            target[row, places[first + row, k]] = other


def write_faces(tetrahedra, neighbours, corners, sides):  # type: ignore[no-untyped-def]
    """Write each face once.

    Parameters
    ----------
    neighbours : uint32 (m, 4)
    corners : uint32 (f, 3), written
    sides : uint32 (f, 2), written
    """
    face = 0
    for row in range(len(tetrahedra)):
        for k in range(4):
            other = neighbours[row, k]
            if other != NONE and other < 4 * row + k:
                continue
            a, b, c, odd = _corners(tetrahedra, row, k)
            corners[face, 0], corners[face, 1], corners[face, 2] = a, b, c
            sides[face, odd] = row
            sides[face, 1 - odd] = other >> 2 if other != NONE else NONE
            face += 1


@_function
def _sort(keys, numbers, begin, end):  # type: ignore[no-untyped-def]
    """Sort a bucket by insertion; first, in a large one, half-faces that lie far apart (Shell's sort)."""
    apart = 1
    while SMALL * apart < end - begin:
        apart = 3 * apart + 1
    while apart > 0:
        for n in range(begin + apart, end):
            key, number, at = keys[n], numbers[n], n
            while at >= begin + apart and (
                keys[at - apart] > key or (keys[at - apart] == key and numbers[at - apart] > number)
            ):
                keys[at], numbers[at] = keys[at - apart], numbers[at - apart]
                at -= apart
            keys[at], numbers[at] = key, number
        apart //= 3
