"""Marching-cubes table: which corners lie in front of the plane gives the edges of the polygon, in order.

Only the polygon's own edges are cut, and nothing is validated or sorted. Of the 256 sets of corners only those occur
that hold, with a corner, all that are nearer; the others have no polygon. The table is made from the sets of crossed
edges by walking from face to face.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
A. Benassarou, E. Bittar, N. W. John, L. Lucas: MC slicing for volume rendering applications, ICCS 2005.
"""

from __future__ import annotations

import numpy as np

from clusterviz.plan.slices.brute_force import walk_faces
from clusterviz.plan.slices.contract import EDGES, Cuts, Integers, Polygons, points_on, shares


def _table() -> tuple[Integers, Integers]:
    """Return the edges (256, 6) and their number (256,) for each set of corners in front of the plane."""
    codes = np.arange(256)
    has = (codes[:, None] >> np.arange(8) & 1).astype(bool)
    near, far = EDGES.T
    is_nested = ~(has[:, far] & ~has[:, near]).any(axis=1)
    return walk_faces(has[:, near] & ~has[:, far] & is_nested[:, None])


TABLE, COUNTS = _table()


def marching_cubes_table(cuts: Cuts) -> Polygons:
    """Return the polygons of planes in boxes."""
    levels = cuts.corner_levels
    codes = np.packbits(levels <= cuts.level[:, None], axis=1, bitorder="little")[:, 0]
    edges, counts = TABLE[codes], COUNTS[codes]
    near, far = (np.take_along_axis(levels, EDGES[edges, end], axis=1) for end in (0, 1))
    return Polygons(points_on(cuts, edges, shares(cuts.level[:, None], near, far)), counts)
