"""The witness of several volumes in one scene: emission and absorption of their mixture, slab by slab.

Rays are cut into slabs in the axis-aligned box around all volumes. A slab lies in every volume that holds its midpoint;
there the extinctions add up, κ = Σ κ_i, and its colour is that of the particles in it: Σ κ_i c_i / Σ κ_i.

References
----------
N. Max: Optical models for direct volume rendering, IEEE TVCG 1(2), 1995, section 2 and 4: particles of several kinds
absorb and glow independently, so both densities are sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.reference.clipping import kept
from clusterviz.reference.fields import SAMPLERS, gradient_at
from clusterviz.reference.grading import needs_gradient, optics
from clusterviz.reference.lighting import lit
from clusterviz.reference.rays import Floats, Rays, to_index_space
from clusterviz.reference.slabs import slabs_in
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.values import Scene, Volume

DARK = 2.0**-60
SLACK = 1e-9
"""Of its length, by which a volume's box is widened, so that rounding does not decide who sees what lies on a face."""


@dataclass(frozen=True)
class Body:
    """One of the volumes: its scene entry, its grid and its voxels (z, y, x)."""

    volume: Volume
    grid: Grid
    voxels: NDArray[Any]

    @property
    def has_extent(self) -> bool:
        """Whether it is thick along every axis; else it shows nothing."""
        return min(self.grid.shape_zyx) > 1


def march_mixture(rays: Rays, bodies: Sequence[Body], step: float, scene: Scene) -> Floats:
    """The colours of some rays, float64 (n, 4), premultiplied.

    Parameters
    ----------
    rays : in the world
    bodies : the volumes, in any order: a mixture has none
    step : length of a slab in the smallest spacing of all volumes
    scene : for its lights and its clipping
    """
    corners = np.concatenate([body.grid.corners for body in bodies])
    low, high = corners.min(axis=0), corners.max(axis=0)
    length = step * min(min(body.grid.spacing) for body in bodies)
    # World lengths from the box's low corner.
    box = Grid((1, 1, 1), origin=(float(low[0]), float(low[1]), float(low[2])))
    rgba, transmittance = np.zeros((len(rays.direction), 4)), np.ones(len(rays.direction))
    thick = [body for body in bodies if body.has_extent]
    for slab in slabs_in(to_index_space(rays, box), high - low, length, lambda: transmittance > DARK):
        some = Rays(slab.point + low, rays.direction[slab.rays])
        seen = kept(slab.point, scene.clip, box)
        parts = [_extinction_and_colour(some, body, scene, seen) for body in thick]
        kappa = np.sum([part[0] for part in parts], axis=0) if parts else np.zeros(len(seen))
        glow = np.sum([part[0][:, None] * part[1] for part in parts], axis=0) if parts else np.zeros((len(seen), 3))
        depth = kappa * (slab.end - slab.begin)
        weight = transmittance[slab.rays] * -np.expm1(-depth)
        rgba[slab.rays, :3] += weight[:, None] * glow / np.where(kappa > 0, kappa, 1)[:, None]
        rgba[slab.rays, 3] += weight
        transmittance[slab.rays] *= np.exp(-depth)
    return rgba


def _extinction_and_colour(some: Rays, body: Body, scene: Scene, seen: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """κ_i (n,) and c_i (n, 3) at points of rays, both 0 where the volume is not or has no scalar.

    Parameters
    ----------
    some : start at the points, in the world
    seen : what is not clipped
    """
    volume, grid = body.volume, body.grid
    local = to_index_space(some, grid)
    last = np.array(grid.shape_zyx[::-1], np.float64) - 1
    inside = seen & ((local.start >= -SLACK * last) & (local.start <= (1 + SLACK) * last)).all(axis=1)
    kappa, colour = np.zeros(len(seen)), np.zeros((len(seen), 3))
    point = np.clip(local.start[inside], 0, last)
    scalar, valid = SAMPLERS[volume.interpolation](body.voxels, *point.T)
    transfer = transfer_function(volume)
    gradient = gradient_at(volume, body.voxels, point) if needs_gradient(volume) else None
    found, extinction = optics(volume, transfer, scalar, gradient, grid)
    kappa[inside] = np.where(valid, extinction, 0)
    found = np.where(valid[:, None], found, 0)
    if volume.shade and gradient is not None:
        found = lit(found, gradient, point, local.direction[inside], volume, scene.lights, grid)
    colour[inside] = found
    return kappa, colour
