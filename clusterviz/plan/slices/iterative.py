"""Iterative: consecutive planes meet an edge at equal distances, so each intersection is the last plus a constant.

That saves the divisions of brute force; validating and sorting are the same. Rounding errors add up from plane to
plane. Two things keep slices watertight all the same: corners decide which edges a plane meets, and additions begin at
every `RESTART`-th plane of the whole slicing rather than at a box's first, so that all boxes add the same numbers.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.3.
"""

from __future__ import annotations

import numpy as np

from clusterviz.plan.slices.brute_force import sorted_polygons
from clusterviz.plan.slices.contract import EDGES, Cuts, Polygons

RESTART = 16
"""Planes after which an intersection is computed rather than added up."""


def iterative(cuts: Cuts) -> Polygons:
    """Return the polygons of planes in boxes."""
    levels, level = cuts.corner_levels, cuts.level[:, None]
    near, far = levels[:, EDGES[:, 0]], levels[:, EDGES[:, 1]]
    valid = (near <= level) & (level < far)
    additions = np.floor(level).astype(np.int64) & (RESTART - 1)
    constant = 1.0 / np.where(far > near, far - near, 1.0)
    share = ((level - additions) - near) * constant
    for number in range(1, RESTART):
        share = np.where(additions >= number, share + constant, share)
    return sorted_polygons(cuts, valid, np.clip(share, 0.0, 1.0))
