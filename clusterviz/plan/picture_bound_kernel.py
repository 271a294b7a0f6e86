"""Bounds of the errors of pixels by rays through bricks, compiled by numba; see `picture_bound.py`."""

from __future__ import annotations

import math
from typing import Any

import numba

from clusterviz.plan.picture_bound import (
    CENTRE,
    DENSE,
    EXTENT,
    EYE,
    FORWARD,
    LATTICE,
    LENS,
    RIGHT,
    SHARE,
    SLAB,
    THIN,
    UP,
)

NEAR = 1e-9  # slabs, or bricks; more than the rounding of positions

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_inline = numba.njit(inline="always", **_OPTIONS)


@_inline
def _set_ray(camera, planes, x, y, ray):  # type: ignore[no-untyped-def]
    """Set origin and direction of a pixel's ray, in bricks; return entry, exit, and the part that planes keep."""
    across = (x + 0.5 - camera[CENTRE, 0]) * camera[LENS, 0]
    above = (camera[CENTRE, 1] - y - 0.5) * camera[LENS, 0]
    parallel = camera[LENS, 1] != 0
    scale = 1.0 if parallel else 1.0 / math.sqrt(1.0 + across * across + above * above)
    entry, leave, side = 0.0, math.inf, camera[LATTICE, 0]
    for axis in range(3):
        aside = across * camera[RIGHT, axis] + above * camera[UP, axis]
        origin = camera[EYE, axis] + (aside if parallel else 0.0)
        direction = camera[FORWARD, axis] if parallel else (camera[FORWARD, axis] + aside) * scale
        if direction != 0:
            a, b = -origin / direction, (camera[EXTENT, axis] - origin) / direction
            entry, leave = max(entry, min(a, b)), min(leave, max(a, b))
        elif origin < 0 or origin > camera[EXTENT, axis]:
            leave = -1.0
        ray[axis, 0], ray[axis, 1] = origin / side, direction / side
    begin, end = entry, leave
    for plane in range(len(planes)):
        at, by = planes[plane, 3], 0.0
        for axis in range(3):
            at += planes[plane, axis] * ray[axis, 0] * side
            by += planes[plane, axis] * ray[axis, 1] * side
        if by > 0:
            begin = max(begin, -at / by)
        elif by < 0:
            end = min(end, -at / by)
        elif at < 0:
            end = -1.0
    return entry, leave, begin, end


@_inline
def _slabs(begin, end, margin, most):  # type: ignore[no-untyped-def]
    """Return how many whole slabs have midpoints in a part of a ray, widened by a margin; all lengths in slabs."""
    return max(min(math.ceil(end - 0.5 + margin), most) - max(math.ceil(begin - 0.5 - margin), 0.0), 0.0)


@_inline
def _take(terms, index, beside, taken):  # type: ignore[no-untyped-def]
    """Take the terms of a brick, or the worst of those on both sides of faces in which a ray lies."""
    for n in range(4):
        taken[n] = terms[index[2], index[1], index[0], n]
    if beside[0] == 0 and beside[1] == 0 and beside[2] == 0:
        return
    for other in range(1, 8):
        x = index[0] + beside[0] * (other & 1)
        y = index[1] + beside[1] * (other >> 1 & 1)
        z = index[2] + beside[2] * (other >> 2)
        for n in range(4):
            there = terms[z, y, x, n]
            taken[n] = min(taken[n], there) if n == THIN else max(taken[n], there)


def bound_rays(pixels, camera, planes, terms, cuts, found, shares, visited, ray, index):  # type: ignore[no-untyped-def]
    """Bound the error of pixels, and add up what each brick contributes.

    Parameters
    ----------
    pixels : int64 (n, 2), x and y
    camera : float64 (8, 3), rows `EYE` … `LATTICE`
    planes : float64 (m, 4), clipping planes in index space
    terms : float64 (bz, by, bx, 4), `SLAB` … `DENSE` of each brick
    cuts : slabs that a brick may have beyond those counted from where rays enter the domain
    found : float64 (n,), set to the bound of each pixel
    shares : float64 (bz, by, bx, 2); the contributions of a brick are added to the first, the second is the largest
    visited : float64 (k, 4), for the terms of a ray's bricks, of which two then become contribution and transparency
    ray : float64 (3, 3), for origin, direction, and the next face
    index : int64 (3, 3), for the brick, the direction from brick to brick, and the other brick at a face
    """
    step = camera[LATTICE, 1]
    sides = (terms.shape[2], terms.shape[1], terms.shape[0])
    for pixel in range(len(pixels)):
        found[pixel] = 0.0
        entry, leave, begin, end = _set_ray(camera, planes, pixels[pixel, 0], pixels[pixel, 1], ray)
        end = min(end, leave)
        if not begin < end:
            continue
        slabs = math.ceil((leave - entry) / step)
        last = entry + 0.5 * ((slabs - 1.0) * step + leave - entry)
        for axis in range(3):
            position = ray[axis, 0] + begin * ray[axis, 1]
            index[0, axis] = min(max(math.floor(position), 0), sides[axis] - 1)
            index[1, axis] = 1 if ray[axis, 1] > 0 else -1
            index[2, axis] = 0
            nearest = math.floor(position + 0.5)
            if abs(ray[axis, 1]) * (end - begin) < NEAR and abs(position - nearest) < NEAR:
                other = nearest - 1 if index[0, axis] == nearest else nearest
                index[2, axis] = other - index[0, axis] if 0 <= other < sides[axis] else 0
            face = index[0, axis] + (ray[axis, 1] > 0)
            ray[axis, 2] = (face - ray[axis, 0]) / ray[axis, 1] if ray[axis, 1] != 0 else math.inf
        count, at, transparency = 0, begin, 1.0
        while True:
            axis = 0
            for n in (1, 2):
                if ray[n, 2] < ray[axis, 2]:
                    axis = n
            to = max(at, min(ray[axis, 2], end))
            row = visited[count]
            _take(terms, index[0], index[2], row)
            a, b = (at - entry) / step, (to - entry) / step
            error, passed = 0.0, 1.0
            if row[SLAB] > 0:
                most = _slabs(a, b, NEAR, slabs - 1.0) + cuts
                weight = most if row[THIN] <= 0 else min(most, -1.0 / math.expm1(-row[THIN]))
                error = weight * row[SLAB]
                if cuts > 0 or (at - NEAR * step <= last and last <= to + NEAR * step):
                    error += row[SHARE]
                error = min(error, -math.expm1(-row[DENSE] * (most + 1.0)))
                share = error * transparency
                z, y, x = index[0, 2], index[0, 1], index[0, 0]
                shares[z, y, x, 0] += share
                shares[z, y, x, 1] = max(shares[z, y, x, 1], share)
            if row[THIN] > 0:
                passed = math.exp(-row[THIN] * max(_slabs(a, b, -NEAR, slabs - 1.0) - cuts, 0.0))
            row[0], row[1] = error, passed
            transparency *= passed
            count += 1
            at = to
            if to >= end or count == len(visited):
                break
            index[0, axis] += index[1, axis]
            if index[0, axis] < 0 or index[0, axis] >= sides[axis]:
                break
            face = index[0, axis] + (ray[axis, 1] > 0)
            ray[axis, 2] = (face - ray[axis, 0]) / ray[axis, 1]
        bound = 0.0
        for n in range(count - 1, -1, -1):
            bound = min(1.0, visited[n, 0] + visited[n, 1] * bound)
        found[pixel] = bound
