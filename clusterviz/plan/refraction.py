"""Refraction of a spectral volume: what rays that bend have in common.

Along a ray of arc length s, with the refractive index n, the momentum v = n dx/ds changes by dv/ds = ∇n. These are
Hamilton's equations of |v| − n(x) = 0. In index space x are voxels, and the momentum u = Mᵀ v, with M the matrix from
voxels to world units, so that du/ds is the gradient along voxels, |v|² = uᵀ (Mᵀ M)⁻¹ u, and the direction of the ray is
(Mᵀ M)⁻¹ u, with an arc length in world units.

A slab is a step of the leapfrog method: half of its length straight on, a change of the momentum by its length times
the gradient in its middle, where the scalar is sampled, too, and half of its length in the new direction. The method is
of second order, and symplectic, so that |v| − n does not drift. Where n is constant, slabs are those of straight rays.

At the faces of the volume, and where the index has a step at a scalar, the momentum along the normal becomes what
Snell's law says, or changes its sign: total reflection. No light is split there: Fresnel's reflection is left out, and
the whole ray goes on. So R + T is at most 1, and 1 without absorption.

References
----------
A. Sharma, D. V. Kumar, A. K. Ghatak: Tracing rays through graded-index media, Applied Optics 21(6), 1982. E. Hairer,
C. Lubich, G. Wanner: Geometric numerical integration, 2006, section I.1 (leapfrog). D. Rodgman, M. Chen: Refraction in
volume graphics, Graphical Models 68(5), 2006. M. Strengert, Parallel Visualization and Compute Environments for
Graphics Clusters, Stuttgart 2010, section 3.3.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.source import Grid
from clusterviz.scene.values import Volume

MOST_DIAGONALS = 16
"""Length of a ray in the volume, in diagonals of it, at which it ends."""
MOST_REFLECTIONS = 256
"""Total reflections of a ray, at which it ends."""


@dataclass(frozen=True, eq=False)
class Refraction:
    """How rays bend.

    `begin`, `end`: cells (x, y, z) of the box around the bricks that are not hidden; outside of it rays are straight.
    """

    metric: NDArray[np.float64]  # float64 (3, 3), Mᵀ M, M from voxels (x, y, z) to the world
    outside: float  # refractive index around the volume, and in hidden bricks
    most_slabs: int  # of a ray
    begin: tuple[int, int, int]
    end: tuple[int, int, int]


def make_refraction(
    volume: Volume, grid: Grid, layout: BrickLayout, shown: NDArray[np.bool_], step_world: float
) -> Refraction | None:
    """Return how rays bend in a volume; None if they are straight.

    `shown`: bool (bz, by, bx), bricks that are not hidden. `step_world`: length of a slab in world units.
    """
    if volume.optics is None or not volume.refracts:
        return None
    bricks = np.argwhere(shown)
    begin, end = (0, 0, 0), (0, 0, 0)
    if len(bricks):
        begin, end = layout.cells_of(tuple(bricks.min(axis=0).tolist()), tuple((bricks.max(axis=0) + 1).tolist()))
    matrix = grid.world_from_index[:3, :3]
    diagonal = float(np.linalg.norm(grid.corners[7] - grid.corners[0]))
    most = int(min(MOST_DIAGONALS * np.ceil(diagonal / step_world) + 1, 1 << 24))
    outside = volume.optics.outside_index or 1.0
    return Refraction(matrix.T @ matrix, outside, most, (begin[2], begin[1], begin[0]), (end[2], end[1], end[0]))
