"""Fragments of faces in each pixel, and the entries that bring them in order, compiled by numba."""

from __future__ import annotations

import math
from typing import Any

import numba

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_inline = numba.njit(inline="always", **_OPTIONS)


@_inline
def _side(ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Return the sign of an edge's side, for a ray that is moved by (ε, ε²)."""
    side = ax * by - ay * bx
    if side == 0:
        side = ay - by if ay != by else bx - ax
    return 1 if side > 0 else -1 if side < 0 else 0


def list_fragments(vertices, lens, order, faces, places, depths):  # type: ignore[no-untyped-def]
    """Count the fragments of each pixel, or write their depths in the order of the faces.

    Parameters
    ----------
    vertices : float64 (n, 3), to the right, above and ahead of the eye
    lens : float64 (2,), distance of pixels, on the plane one unit ahead in perspective; 1 for perspective
    order : uint32 (f,), of the faces
    faces : uint32 (f, 3), corners
    places : int64 (down, across), raised by the fragments of each pixel; where depths are written, the next place
    depths : float64 (k,), written; (0,) to count
    """
    down, across = places.shape
    pixel, perspective = lens[0], lens[1] != 0
    for n in range(len(order)):
        a, b, c = faces[order[n], 0], faces[order[n], 1], faces[order[n], 2]
        low_u, high_u, low_v, high_v = math.inf, -math.inf, math.inf, -math.inf
        for k in range(3):
            at = a if k == 0 else b if k == 1 else c
            ahead = pixel * (vertices[at, 2] if perspective else 1.0)
            u = vertices[at, 0] / ahead + 0.5 * (across - 1)
            v = 0.5 * (down - 1) - vertices[at, 1] / ahead
            low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
        first_u, last_u = max(0, math.floor(low_u)), min(across - 1, math.ceil(high_u))
        first_v, last_v = max(0, math.floor(low_v)), min(down - 1, math.ceil(high_v))
        for row in range(first_v, last_v + 1):
            y = pixel * (0.5 * (down - 1) - row)
            for column in range(first_u, last_u + 1):
                x = pixel * (column - 0.5 * (across - 1))
                az, bz, cz = (vertices[a, 2], vertices[b, 2], vertices[c, 2]) if perspective else (1.0, 1.0, 1.0)
                ax, ay = vertices[a, 0] - x * az, vertices[a, 1] - y * az
                bx, by = vertices[b, 0] - x * bz, vertices[b, 1] - y * bz
                cx, cy = vertices[c, 0] - x * cz, vertices[c, 1] - y * cz
                turn = _side(ax, ay, bx, by)
                if turn == 0 or _side(bx, by, cx, cy) != turn or _side(cx, cy, ax, ay) != turn:
                    continue
                if len(depths):
                    of_a, of_b, of_c = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
                    depth = of_a * vertices[a, 2] + of_b * vertices[b, 2] + of_c * vertices[c, 2]
                    depths[places[row, column]] = depth / (of_a + of_b + of_c)
                places[row, column] += 1


def count_entries(begins, depths, needed):  # type: ignore[no-untyped-def]
    """Sort the fragments of each pixel, and write how many entries a k-buffer needs for it.

    `begins`: int64 (n + 1,), of each pixel in `depths`. `depths`: float64 (k,), sorted. `needed`: int32 (n,), written;
    0 without fragments, else 2 at least.
    """
    for pixel in range(len(needed)):
        most = 2 if begins[pixel + 1] > begins[pixel] else 0
        for n in range(begins[pixel] + 1, begins[pixel + 1]):
            depth, at = depths[n], n
            while at > begins[pixel] and depths[at - 1] > depth:
                depths[at] = depths[at - 1]
                at -= 1
            depths[at] = depth
            most = max(most, n - at + (1 if at > begins[pixel] else 0))
        needed[pixel] = most
