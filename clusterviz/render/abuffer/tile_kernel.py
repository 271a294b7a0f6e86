"""Vertices in the camera's coordinates and on the picture, and the primitives of each tile, compiled by numba.

A tile's list holds all primitives that its pixels' rays may meet. What crosses the plane of the eye is in all lists.
"""

from __future__ import annotations

import math
from typing import Any

import numba

ROUNDED = 1e-6  # of float32 coordinates, with a margin
ROUNDED_DEPTH = 1e-5  # of fragments, with a margin
MARGIN = 1e-2  # pixels
ENTRY = 3  # kind of a face at the boundary of a grid, where rays enter; the next kind: any face, for k-buffers
LENS = 9  # numbers of `lens_of`

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_inline = numba.njit(inline="always", **_OPTIONS)


def move(matrix, unit, lens, positions, radii, target, boxes):  # type: ignore[no-untyped-def]
    """Write positions in the camera's coordinates, radii, and the boxes of pixels in which they are.

    A box is a bound: it holds a sphere around the position, and all that rounding may change.

    Parameters
    ----------
    matrix : float64 (3, 4), maps (x, y, z, 1) of the file
    unit : float64 (1,), camera units of a world unit
    lens : float64 (LENS,)
    positions : float32 or float64 (n, 3)
    radii : float32 (n,), world units; or (0,); of corners of cells what is written behind their positions
    target : float32 (n, 4)
    boxes : float32 (n, 4), least and greatest column and row; infinite columns if not ahead of the eye, and no row if
        behind it; for corners of cells behind it those of the line through the eye, as walks may begin there
    """
    for n in range(len(positions)):
        x, y, z = positions[n, 0], positions[n, 1], positions[n, 2]
        for axis in range(3):
            target[n, axis] = matrix[axis, 0] * x + matrix[axis, 1] * y + matrix[axis, 2] * z + matrix[axis, 3]
        target[n, 3] = radii[n] * unit[0] if len(radii) else 0.0
        x, y, z = target[n, 0] - lens[1], lens[2] - target[n, 1], target[n, 2] - lens[0]
        r = 0.0 if lens[8] != 0 else target[n, 3]
        size = ROUNDED * (abs(target[n, 0]) + abs(target[n, 1]) + abs(target[n, 2]) * (1 + lens[7]) + r)
        near, far, e = (z - r, z + r, r + size) if lens[6] != 0 else (1.0, 1.0, r + size)
        if lens[6] != 0 and lens[8] != 0 and far < -size:
            x, y, near, far = -x, -y, -far, -near
        if lens[6] != 0 and not near > size:
            boxes[n, 0], boxes[n, 1] = -math.inf, math.inf
            boxes[n, 2], boxes[n, 3] = (math.inf, -math.inf) if far < 0 else (-math.inf, math.inf)
            continue
        near, far = lens[3] / near, lens[3] / far
        boxes[n, 0] = _below((x - e) * (near if x < e else far) + lens[4])
        boxes[n, 1] = -_below(-(x + e) * (far if x < -e else near) - lens[4])
        boxes[n, 2] = _below((y - e) * (near if y < e else far) + lens[5])
        boxes[n, 3] = -_below(-(y + e) * (far if y < -e else near) - lens[5])


@_inline
def _below(number):  # type: ignore[no-untyped-def]
    return number - MARGIN - ROUNDED * abs(number)


def list_tiles(  # type: ignore[no-untyped-def]
    shift, width, height, eye, layers, begin, end, boxes, corners, vertices, limits, left_out, counts, pairs
):
    """Find the primitives of each tile among some, and return how many pairs of a tile and a primitive there are.

    Parameters
    ----------
    shift : log2 of the pixels along the side of a tile
    width, height : of the rectangle of pixels
    eye : float64 (1,), its depth; −∞ if rays are parallel
    layers : int64 (layers + 1, 2), first row and kind of each, as in primitives.glsl; the last is the end
    begin, end : rows of primitives
    boxes : float32 (n, 4), as in `move`
    corners : int32 (m, 4), vertices of all primitives
    vertices : float32 (n, 4)
    limits : float32 (tiles,), depths behind which primitives are left out; (0,): none are
    left_out : float32 (tiles,), lowered to depths that what is left out is not nearer than
    counts : int64 (tiles,), raised by the pairs of each tile
    pairs : int64 (k,), number of the tile · 2³² + row; those beyond the end are only counted
    """
    found, across = 0, (width - 1 >> shift) + 1
    for layer in range(len(layers) - 1):
        kind = layers[layer, 1]
        is_triangle = kind == 0 or kind >= ENTRY
        first, middle, last = (0, 1, 2) if is_triangle else (1, 2, 2) if kind == 1 else (0, 0, 0)
        for row in range(max(begin, layers[layer, 0]), min(end, layers[layer + 1, 0])):
            p, q, r = corners[row, first], corners[row, middle], corners[row, last]
            x_low = min(min(boxes[p, 0], boxes[q, 0]), boxes[r, 0])
            x_high = max(max(boxes[p, 1], boxes[q, 1]), boxes[r, 1])
            y_low = min(min(boxes[p, 2], boxes[q, 2]), boxes[r, 2])
            y_high = max(max(boxes[p, 3], boxes[q, 3]), boxes[r, 3])
            is_cut = x_low == -math.inf and y_low < math.inf
            if kind >= ENTRY:
                ahead = vertices[p, 2] > eye[0]
                is_cut = is_cut or ahead != (vertices[q, 2] > eye[0]) or ahead != (vertices[r, 2] > eye[0])
            if is_cut:
                x_low, x_high, y_low, y_high = -math.inf, math.inf, -math.inf, math.inf
            # Centres of pixels.
            i, i_end = math.ceil(min(max(x_low, 0.0), width)), math.floor(max(min(x_high, width - 1.0), -1.0))
            j, j_end = math.ceil(min(max(y_low, 0.0), height)), math.floor(max(min(y_high, height - 1.0), -1.0))
            if i > i_end or j > j_end:
                continue
            depth = -math.inf
            if len(limits):
                a, b, c = vertices[p, 2], vertices[q, 2], vertices[r, 2]
                radius = 0.0 if is_triangle else vertices[p, 3]
                depth = min(min(a, b), c) - radius - ROUNDED_DEPTH * (abs(a) + abs(b) + abs(c) + radius)
            # Sides of a triangle: a · column + b · row + c is at least 0 inside.
            a0 = b0 = c0 = a1 = b1 = c1 = a2 = b2 = c2 = 0.0
            if is_triangle and not is_cut:
                px, py, qx, qy = _middle(boxes, p, 0), _middle(boxes, p, 2), _middle(boxes, q, 0), _middle(boxes, q, 2)
                rx, ry = _middle(boxes, r, 0), _middle(boxes, r, 2)
                turn = (qx - px) * (ry - py) - (qy - py) * (rx - px)
                u = max(max(boxes[p, 1] - px, boxes[q, 1] - qx), boxes[r, 1] - rx)
                v = max(max(boxes[p, 3] - py, boxes[q, 3] - qy), boxes[r, 3] - ry)
                # Rays leave by a face that is clockwise, with rows upwards, however its corners are rounded.
                rounded = 2 * v * (abs(qx - px) + abs(rx - px)) + 2 * u * (abs(qy - py) + abs(ry - py)) + 8 * u * v
                if kind == ENTRY and turn > rounded:
                    continue
                turn = 1.0 if turn > 0 else -1.0 if turn < 0 else 0.0
                a0, b0, c0 = _side(px, py, qx, qy, turn, u, v)
                a1, b1, c1 = _side(qx, qy, rx, ry, turn, u, v)
                a2, b2, c2 = _side(rx, ry, px, py, turn, u, v)
            for below in range(j >> shift, (j_end >> shift) + 1):
                top, bottom = below << shift, (below + 1 << shift) - 1
                for beside in range(i >> shift, (i_end >> shift) + 1):
                    left, right = beside << shift, (beside + 1 << shift) - 1
                    if (
                        (right if a0 > 0 else left) * a0 + (bottom if b0 > 0 else top) * b0 + c0 >= 0
                        and (right if a1 > 0 else left) * a1 + (bottom if b1 > 0 else top) * b1 + c1 >= 0
                        and (right if a2 > 0 else left) * a2 + (bottom if b2 > 0 else top) * b2 + c2 >= 0
                    ):
                        tile = below * across + beside
                        if len(limits) and depth > limits[tile]:
                            left_out[tile] = min(left_out[tile], depth)
                            continue
                        counts[tile] += 1
                        if found < len(pairs):
                            pairs[found] = (tile << 32) + row
                        found += 1
    return found


@_inline
def _middle(boxes, at, axis):  # type: ignore[no-untyped-def]
    return 0.5 * (float(boxes[at, axis]) + boxes[at, axis + 1])


@_inline
def _side(px, py, qx, qy, turn, u, v):  # type: ignore[no-untyped-def]
    """Return the numbers of a side, moved outward by as much as its ends may lie elsewhere."""
    a, b = turn * (py - qy), turn * (qx - px)
    return a, b, u * abs(a) + v * abs(b) - a * px - b * py


def place(pairs, places, rows):  # type: ignore[no-untyped-def]
    """Write rows where the lists of their tiles are.

    Parameters
    ----------
    pairs : int64 (k,), as in `list_tiles`
    places : int64 (tiles,), the next free place of each tile in `rows`
    rows : uint32 (n,)
    """
    for pair in pairs:
        tile = pair >> 32
        rows[places[tile]] = pair & 0xFFFFFFFF
        places[tile] += 1
