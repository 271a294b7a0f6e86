"""Reprojection of the last frame's hits to the starts of this frame's rays, compiled by numba.

The hits of the last frame form a surface: those of four neighbouring rays are the corners of one cell of it. It
separates space that is known to be empty, in front of it, from unknown space, and hidden features come into view only
through it. If the depths of a cell's hits are similar, the cell lies between them. If not, it extends from the nearest
hit as far as each ray reached, or to where it left the box, and one pixel further at the nearest depth. A cell is drawn
as the rectangle of pixels around it, at the depth of its nearest corner; the nearest cell wins.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2;
R. Yagel, Z. Shi: Accelerating volume animation by space-leaping, Visualization 1993 (cells in place of points).
"""

from __future__ import annotations

import math
from typing import Any

import numba

LENS = 16  # numbers of a camera: three rows of four, half the width and height, pixel, 1 for parallel projection
BOX = 6  # least and greatest x, y, z
ROUNDED = 1e-3  # pixels
GROWN = 8.0  # pixels
RIM = 1.0  # pixels around cells whose rays did not all hit, or at different depths

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_inline = numba.njit(inline="always", **_OPTIONS)
_called = numba.njit(**_OPTIONS)


def reproject(numbers, sizes, hits, places, target):  # type: ignore[no-untyped-def]
    """Lower view depths in `target` to those at which rays may meet something that the last frame hit or hid.

    Parameters
    ----------
    numbers : float64: rays and projection of the last frame and of this one (LENS each), the box (BOX), and the
        largest difference between depths on one surface
    sizes : int64: the last frame's rectangle of pixels (x, y, width, height), its rows and columns in memory; this
        frame's rectangle and columns in memory; 1 if the box may extend beyond the last picture; a rectangle of pixels
        (begin and end) whose rays certainly enter the box where it was shown; the last frame's rectangle around all
        hits
    hits : float32 (3, rows, columns), (x, y, z) of the last frame; NaN where a ray met nothing
    places : float32 (4, height, width), memory for their pixels and depths in this frame, and depths in the last
    target : float32 (rows, columns), view depths at which rays start in this frame
    """
    ray, last, seen = numbers[:LENS], numbers[LENS : 2 * LENS], numbers[3 * LENS : 4 * LENS]
    box, smooth_depth = numbers[4 * LENS : 4 * LENS + BOX], numbers[4 * LENS + BOX]
    rect, bounds, part, width, height = sizes[:4], sizes[6:10], sizes[16:20], sizes[2], sizes[3]
    for y in range(max(part[1] - 1, 0), min(part[3] + 1, height)):
        for x in range(max(part[0] - 1, 0), min(part[2] + 1, width)):
            u, v, depth = _projected(seen, hits[0, y, x], hits[1, y, x], hits[2, y, x])
            places[0, y, x], places[1, y, x], places[2, y, x] = u, v, depth
            places[3, y, x] = _depth(last, hits[0, y, x], hits[1, y, x], hits[2, y, x])
    for y in range(part[1] - 1, part[3]):
        for x in range(part[0] - 1, part[2]):
            if 0 <= x < width - 1 and 0 <= y < height - 1:
                least, most, found = _around(places[3], x, y)
                if found == 0:
                    continue
                if found == 4:
                    sides, depth = _between_hits(places, x, y)
                    if most - least > smooth_depth:
                        sides, depth = _before_hits(ray, seen, rect, (x, y), float(least), sides, depth)
                        # A nearer surface may extend into the next cell, although all of that cell's rays passed it.
                        sides = (sides[0] - RIM, sides[1] + RIM, sides[2] - RIM, sides[3] + RIM)
                    _splat(sides, depth, bounds, target)
                    continue
            _splat_rim(ray, box, seen, rect, places, (x, y), bounds, target)
    if sizes[11]:
        _start_unseen(numbers[2 * LENS : 3 * LENS], box, last, rect, bounds, sizes[12:16], target)


def move_ends(numbers, sizes, depths, places, target):  # type: ignore[no-untyped-def]
    """Raise depths to those at which rays should end.

    The ends of four neighbouring rays of the last frame are the corners of a cell, which is drawn as the rectangle of
    pixels around it, at the depth of its farthest corner; the farthest cell wins. Cells that have grown much are left
    out.

    Parameters
    ----------
    numbers : float64: rays of the last frame and projection of this one (LENS each)
    sizes : int64: rectangles of pixels (x, y, width, height) of the last frame and of this one
    depths : float64 (height, width) of the last frame, NaN where no ray ended
    places : float64 (3, height, width), memory for their pixels and depths in this frame
    target : float64 (height, width) of this frame
    """
    ray, seen, rect, bounds = numbers[:LENS], numbers[LENS:], sizes[:4], sizes[4:]
    for y in range(rect[3]):
        for x in range(rect[2]):
            point = _on_ray(ray, rect[0] + x, rect[1] + y, depths[y, x])
            places[0, y, x], places[1, y, x], depth = _projected(seen, point[0], point[1], point[2])
            places[2, y, x] = depth if depth > 0.0 or seen[15] != 0.0 else math.nan
    for y in range(rect[3] - 1):
        for x in range(rect[2] - 1):
            _, depth, known = _around(places[2], x, y)
            if known < 4:
                continue
            (left, right, top, bottom), _ = _between_hits(places, x, y)
            if right - left > GROWN or bottom - top > GROWN:
                continue
            begin_x, end_x = max(math.ceil(left) - bounds[0], 0), min(math.floor(right) - bounds[0] + 1, bounds[2])
            begin_y, end_y = max(math.ceil(top) - bounds[1], 0), min(math.floor(bottom) - bounds[1] + 1, bounds[3])
            for v in range(begin_y, end_y):
                for u in range(begin_x, end_x):
                    target[v, u] = max(target[v, u], depth)


@_inline
def _around(plane, x, y):  # type: ignore[no-untyped-def]
    """Return the least and the greatest of four neighbours, and how many are not NaN."""
    a, b, c, d = plane[y, x], plane[y, x + 1], plane[y + 1, x], plane[y + 1, x + 1]
    return min(min(a, b), min(c, d)), max(max(a, b), max(c, d)), (a == a) + (b == b) + (c == c) + (d == d)


@_inline
def _between_hits(places, x, y):  # type: ignore[no-untyped-def]
    """Return the sides (left, right, top, bottom) and the least depth of a cell in this frame."""
    left, right, _ = _around(places[0], x, y)
    top, bottom, _ = _around(places[1], x, y)
    return (float(left), float(right), float(top), float(bottom)), float(_around(places[2], x, y)[0])


@_inline
def _before_hits(ray, seen, rect, cell, nearest, sides, depth):  # type: ignore[no-untyped-def]
    """Return them for all space that the four rays of a cell passed, from the nearest hit's depth on."""
    left, right, top, bottom = sides
    for number in range(4):
        place = _on_ray(ray, rect[0] + cell[0] + (number & 1), rect[1] + cell[1] + (number >> 1), nearest)
        u, v, ahead = _projected(seen, place[0], place[1], place[2])
        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
        depth = min(depth, ahead)
    return (left, right, top, bottom), depth


@_inline
def _depth(lens, x, y, z):  # type: ignore[no-untyped-def]
    return lens[8] * x + lens[9] * y + lens[10] * z + lens[11]


@_inline
def _projected(lens, x, y, z):  # type: ignore[no-untyped-def]
    """Return the pixel, with integers at centres, and the view depth of a point."""
    aside = lens[0] * x + lens[1] * y + lens[2] * z + lens[3]
    above = lens[4] * x + lens[5] * y + lens[6] * z + lens[7]
    depth = _depth(lens, x, y, z)
    scale = 1.0 / (lens[14] if lens[15] != 0.0 else lens[14] * depth)
    return lens[12] - 0.5 + aside * scale, lens[13] - 0.5 - above * scale, depth


@_inline
def _splat(sides, depth, bounds, target):  # type: ignore[no-untyped-def]
    """Lower the depths of a rectangle of pixels."""
    begin_x, end_x = max(math.ceil(sides[0] - ROUNDED) - bounds[0], 0), math.floor(sides[1] + ROUNDED) - bounds[0] + 1
    begin_y, end_y = max(math.ceil(sides[2] - ROUNDED) - bounds[1], 0), math.floor(sides[3] + ROUNDED) - bounds[1] + 1
    for y in range(begin_y, min(end_y, bounds[3])):
        for x in range(begin_x, min(end_x, bounds[2])):
            target[y, x] = min(target[y, x], depth)


@_called
def _splat_rim(ray, box, seen, rect, places, cell, bounds, target):  # type: ignore[no-untyped-def]
    """Draw a cell some of whose rays hit nothing, or were outside of the rectangle, so that they are unknown."""
    nearest, farthest = math.inf, 0.0
    for number in range(4):
        x, y = cell[0] + (number & 1), cell[1] + (number >> 1)
        enter, leave = _within(ray, box, rect[0] + x, rect[1] + y)
        if not (0 <= x < rect[2] and 0 <= y < rect[3]):
            nearest = min(nearest, enter if leave > enter else math.inf)
        elif places[3, y, x] == places[3, y, x]:
            nearest = min(nearest, places[3, y, x])
        farthest = max(farthest, leave)
    if nearest == math.inf:
        return
    left, right, top, bottom, depth = math.inf, -math.inf, math.inf, -math.inf, math.inf
    for number in range(4):
        x, y = cell[0] + (number & 1), cell[1] + (number >> 1)
        enter, leave = _within(ray, box, rect[0] + x, rect[1] + y)
        end = leave if leave > enter else farthest
        if 0 <= x < rect[2] and 0 <= y < rect[3] and places[3, y, x] == places[3, y, x]:
            end = float(places[3, y, x])
        for along in (nearest, end):
            place = _on_ray(ray, rect[0] + x, rect[1] + y, along)
            u, v, ahead = _projected(seen, place[0], place[1], place[2])
            left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
            depth = min(depth, ahead)
    # A ray beyond the rim of those that hit a surface may just touch it.
    _splat((left - RIM, right + RIM, top - RIM, bottom + RIM), depth, bounds, target)


@_called
def _start_unseen(ray, box, last, rect, bounds, shown, target):  # type: ignore[no-untyped-def]
    """Start rays at their entry if the last picture did not show the box there."""
    for y in range(bounds[3]):
        inside = shown[1] <= bounds[1] + y < shown[3]
        for x in range(bounds[2]):
            if inside and shown[0] <= bounds[0] + x < shown[2]:
                continue
            enter, leave = _within(ray, box, bounds[0] + x, bounds[1] + y)
            if leave > enter:
                place = _on_ray(ray, bounds[0] + x, bounds[1] + y, enter)
                u, v, _ = _projected(last, place[0], place[1], place[2])
                seen = rect[0] <= u <= rect[0] + rect[2] - 1 and rect[1] <= v <= rect[1] + rect[3] - 1
                target[y, x] = target[y, x] if seen else 0.0


@_inline
def _on_ray(ray, column, row, along):  # type: ignore[no-untyped-def]
    """Return the point at a view depth on the ray of a pixel."""
    across, above = (column + 0.5 - ray[12]) * ray[14], (ray[13] - row - 0.5) * ray[14]
    aside = along if ray[15] == 0.0 else 1.0
    x = ray[0] + (ray[1] * across + ray[2] * above) * aside + ray[3] * along
    y = ray[4] + (ray[5] * across + ray[6] * above) * aside + ray[7] * along
    z = ray[8] + (ray[9] * across + ray[10] * above) * aside + ray[11] * along
    return x, y, z


@_inline
def _within(ray, box, column, row):  # type: ignore[no-untyped-def]
    """Return the view depths at which a pixel's ray enters and leaves the box; the former is greater if it misses."""
    begin, end = _on_ray(ray, column, row, 0.0), _on_ray(ray, column, row, 1.0)
    enter, leave = 0.0, math.inf
    for axis in range(3):
        at, by = begin[axis], end[axis] - begin[axis]
        if by == 0.0:
            if at < box[axis] or at > box[axis + 3]:
                leave = -math.inf
        else:
            near, far = (box[axis] - at) / by, (box[axis + 3] - at) / by
            enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
    return enter, leave
