"""The domain of several volumes: the axis-aligned box around them, with cells of their smallest spacing.

Overlapping volumes are combined slab by slab on one rank. So ranks own bricks of the domain, not bricks of one volume.
Rays, slabs, ownership and visibility order refer to the domain alone; `cut.py` finds the voxels of each volume that a
brick of the domain needs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.grid import Grid, Triple
from clusterviz.errors import InputError

MOST_BRICKS = 1 << 20
"""Every rank holds arrays over all bricks."""
ROUNDING = 1e-9
"""Part of a cell by which an extent may exceed a whole number of cells."""


@dataclass(frozen=True)
class Domain:
    """A box in the world.

    Attributes
    ----------
    origin : its low corner (x, y, z), world units
    spacing : side of a cell, world units
    extent : its lengths along x, y, z in cells; not whole numbers
    """

    origin: Triple
    spacing: float
    extent: Triple

    @property
    def grid(self) -> Grid:
        """The grid whose cells cover the box; its index space is that of the domain."""
        z, y, x = (max(1, math.ceil(length - ROUNDING)) + 1 for length in self.extent[::-1])
        return Grid((z, y, x), (self.spacing,) * 3, self.origin)


def make_domain(grids: Sequence[Grid]) -> Domain:
    """Return the domain of one or more volumes."""
    corners = np.concatenate([grid.corners for grid in grids])
    low, high = corners.min(axis=0), corners.max(axis=0)
    spacing = min(min(grid.spacing) for grid in grids)
    x, y, z = (float(length) for length in (high - low) / spacing)
    return Domain((float(low[0]), float(low[1]), float(low[2])), spacing, (x, y, z))


def domain_layout(domain: Domain, brick: int) -> BrickLayout:
    """Return the brick layout of a domain.

    Parameters
    ----------
    brick : cells along the side of one

    Raises
    ------
    InputError
        There would be too many bricks.
    """
    if math.prod(max(1.0, length / brick) for length in domain.extent) > MOST_BRICKS:
        size = " × ".join(f"{length:.3g}" for length in domain.extent)
        raise InputError(
            "the volumes lie too far apart for their smallest spacing",
            where="volumes",
            found=f"{size} cells of {domain.spacing:g} in bricks of {brick}",
            allowed=f"{MOST_BRICKS} bricks; cluster.brick makes them larger",
        )
    return BrickLayout(domain.grid.shape_zyx, brick)
