"""Vertices in the camera's coordinates, and the primitives of each tile of pixels, compiled by numba.

A tile's list holds all primitives that its pixels' rays may meet. What crosses the plane of the eye is in all lists.
"""

from __future__ import annotations

import math
from typing import Any

import numba

ROUNDED = 1e-6  # of float32 coordinates, with a margin
MARGIN = 1e-2  # pixels
LENS = 8  # numbers of `lens_of`

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_inline = numba.njit(inline="always", **_OPTIONS)


def move(matrix, unit, positions, radii, target):  # type: ignore[no-untyped-def]
    """Write positions in the camera's coordinates, and radii.

    Parameters
    ----------
    matrix : float64 (3, 4), maps (x, y, z, 1) of the file
    unit : float64 (1,), camera units of a world unit
    positions : float32 or float64 (n, 3)
    radii : float32 (n,), world units; or (0,)
    target : float32 (n, 4)
    """
    for n in range(len(positions)):
        x, y, z = positions[n, 0], positions[n, 1], positions[n, 2]
        for axis in range(3):
            target[n, axis] = matrix[axis, 0] * x + matrix[axis, 1] * y + matrix[axis, 2] * z + matrix[axis, 3]
        target[n, 3] = radii[n] * unit[0] if len(radii) else 0.0


def list_tiles(lens, tile, kind, row, vertices, corners, places, rows):  # type: ignore[no-untyped-def]
    """Count the primitives of each tile, or write their rows.

    Parameters
    ----------
    lens : float64 (LENS,)
    tile : pixels along its side
    kind : of the primitives, as in primitives.glsl
    row : number of the first one
    vertices : float32 (n, 4)
    corners : int32 (m, 4), vertices of the primitives
    places : int64 (down, across), raised by the primitives of each tile; where rows are written, the first free place
    rows : uint32 (k,), written; (0,) to count
    """
    down, across = places.shape
    first, last = (0, 3) if kind == 0 else (1, 3) if kind == 1 else (0, 1)
    for n in range(len(corners)):
        x_low, x_high, y_low, y_high, is_ahead, is_behind = math.inf, -math.inf, math.inf, -math.inf, True, True
        for k in range(first, last):
            at = corners[n, k]
            x, y, z, r = vertices[at, 0], vertices[at, 1], vertices[at, 2], vertices[at, 3]
            size = ROUNDED * (abs(x) + abs(y) + abs(z) * (1 + lens[7]) + r)
            for side in range(2 if r > 0 else 1):
                ahead = 1.0
                if lens[6] != 0:
                    ahead = z - lens[0] + (r if side else -r)
                    is_behind = is_behind and ahead < 0
                    if not ahead > size:
                        is_ahead = False
                        continue
                else:
                    is_behind = False
                for sign in (-1.0, 1.0):
                    a = (x - lens[1] + sign * (r + size)) / ahead * lens[3] + lens[4]
                    b = lens[5] - (y - lens[2] + sign * (r + size)) / ahead * lens[3]
                    x_low, x_high, y_low, y_high = min(x_low, a), max(x_high, a), min(y_low, b), max(y_high, b)
        if is_behind:
            continue
        # Centres of pixels.
        i, i_end, j, j_end = 0, tile * across - 1, 0, tile * down - 1
        if is_ahead:
            i, i_end = _pixel(math.ceil(x_low - MARGIN), i, i_end + 1), _pixel(math.floor(x_high + MARGIN), -1, i_end)
            j, j_end = _pixel(math.ceil(y_low - MARGIN), j, j_end + 1), _pixel(math.floor(y_high + MARGIN), -1, j_end)
        if i > i_end or j > j_end:
            continue
        for v in range(j // tile, j_end // tile + 1):
            for u in range(i // tile, i_end // tile + 1):
                if len(rows):
                    rows[places[v, u]] = row + n
                places[v, u] += 1


@_inline
def _pixel(number, low, high):  # type: ignore[no-untyped-def]
    """Return a number as an integer between two."""
    return int(min(max(number, low), high))
