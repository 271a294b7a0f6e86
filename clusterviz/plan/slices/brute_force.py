"""Brute force: all twelve edges are cut, valid intersections kept, and sorted around the polygon.

Sorting starts anywhere and goes on with an intersection on the same face, as each face has none or two. Simple, and the
slowest of the generators on CPUs.

The thesis tells of polygons that are incomplete where a plane comes close to a corner: there, validating each line by
itself (`by_lines`) may find one or three intersections on a face, because of rounding or because the corner itself is
on three edges. Validated by corners, which is this module's default, that cannot happen.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

import numpy as np

from clusterviz.plan.slices.contract import (
    AXES,
    EDGES,
    MOST_VERTICES,
    Cuts,
    Flags,
    Floats,
    Integers,
    Polygons,
    points_on,
    repeated,
    shares,
)

FACES_OF_EDGE = np.array(
    [
        [2 * axis + (corners[0] >> axis & 1) for axis in range(3) if axis != own]
        for corners, own in zip(EDGES, AXES, strict=True)
    ]
)
"""The two faces of each edge; face 2 d is the near one along axis d, 2 d + 1 the far one."""
BESIDE = np.array(
    [
        sum(1 << other for other in range(12) if other != edge and set(FACES_OF_EDGE[other]) & set(FACES_OF_EDGE[edge]))
        for edge in range(12)
    ]
)
"""Edges that share a face with each edge, as bits."""
FIRST = np.array([(bits & -bits).bit_length() - 1 for bits in range(1 << 12)])
"""Lowest bit of a set of edges."""


def brute_force(cuts: Cuts, by_lines: bool = False) -> Polygons:
    """Return the polygons of planes in boxes.

    `by_lines`: intersections are validated on each line by itself, in [0, 1], as in the thesis; some polygons are
    wrong.
    """
    levels, level = cuts.corner_levels, cuts.level[:, None]
    near, far = levels[:, EDGES[:, 0]], levels[:, EDGES[:, 1]]
    share = shares(level, near, far)
    valid = (near <= level) & (level < far)
    if by_lines:
        with np.errstate(divide="ignore", invalid="ignore"):
            on_line = (level - near) / (far - near)
        valid = (on_line >= 0) & (on_line <= 1)
    return sorted_polygons(cuts, valid, share)


def sorted_polygons(cuts: Cuts, valid: Flags, share: Floats) -> Polygons:
    """Return the polygons of intersections with edges.

    `valid`: bool (n, 12), the edges that are intersected. `share`: float64 (n, 12), where.
    """
    edges, counts = walk_faces(valid)
    return Polygons(points_on(cuts, edges, np.take_along_axis(share, edges, axis=1)), counts)


def walk_faces(valid: Flags) -> tuple[Integers, Integers]:
    """Return the order of edges around polygons, int64 (n, 6), with the last one repeated, and their number (n,).

    `valid`: bool (n, 12), the edges that are intersected; the walk from face to face begins with the first of them.
    """
    left = (valid * (1 << np.arange(12))).sum(axis=1)
    edges, counts = np.zeros((len(left), MOST_VERTICES), np.int64), np.zeros(len(left), np.int64)
    candidates = left
    for place in range(MOST_VERTICES):
        found = FIRST[candidates]
        counts += found >= 0
        edges[:, place] = found
        taken = np.maximum(found, 0)
        left = left & ~(1 << taken)
        candidates = np.where(found >= 0, left & BESIDE[taken], 0)
    return repeated(edges, counts), counts
