"""Reference of several volumes in one scene: emission and absorption of their mixture, slab by slab.

Rays are cut into slabs in the axis-aligned box around all volumes. A slab lies in every volume that contains its
midpoint. The extinctions of these volumes add up, κ = Σ κ_i, and its colour is the mean Σ κ_i c_i / Σ κ_i. See
`volume_layers.py` for pre-integrated classification and isosurfaces.

References
----------
N. Max: Optical models for direct volume rendering, IEEE TVCG 1(2), 1995, section 2 and 4: particles of several kinds
absorb and glow independently, so both densities are sums.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.reference.clipping import kept
from clusterviz.reference.rays import Floats, Rays, to_index_space
from clusterviz.reference.slabs import Slab, slabs_in
from clusterviz.reference.volume_layers import Body, SurfaceHit, VolumeRays, has_ends
from clusterviz.scene.values import Scene

DARK = 2.0**-60
LONGEST = 2.0
"""Of a slab, in the smallest spacing, where anything depends on the field at its ends."""


def march_mixture(rays: Rays, bodies: Sequence[Body], step: float, scene: Scene) -> Floats:
    """Return the colours of rays, float64 (n, 4), premultiplied.

    Parameters
    ----------
    rays : rays in the world
    bodies : the volumes, in any order
    step : length of a slab in the smallest spacing of all volumes
    scene : for its lights, its clipping and its classification
    """
    corners = np.concatenate([body.grid.corners for body in bodies])
    low, high = corners.min(axis=0), corners.max(axis=0)
    most = LONGEST if any(has_ends(body.volume, scene) for body in bodies) else step
    length = min(step, most) * min(min(body.grid.spacing) for body in bodies)
    # World lengths from the box's low corner.
    box = Grid((1, 1, 1), origin=(float(low[0]), float(low[1]), float(low[2])))
    rgba, transmittance = np.zeros((len(rays.direction), 4)), np.ones(len(rays.direction))
    passages = [VolumeRays(rays, body, scene) for body in bodies if body.has_extent]
    for slab in slabs_in(to_index_space(rays, box), high - low, length, lambda: transmittance > DARK):
        seen = kept(slab.point, scene.clip, box)
        depth, glow = np.zeros(len(seen)), np.zeros((len(seen), 3))
        for passage in passages:
            more, light = passage.absorbing(slab, seen)
            depth, glow = depth + more, glow + light
        colour = glow / np.where(depth > 0, depth, 1)[:, None]
        met = [one for passage in passages for one in passage.surfaces(slab)]
        _pass(rgba, transmittance, slab, depth, colour, met)
    return rgba


def _pass(
    rgba: Floats, transmittance: Floats, slab: Slab, depth: Floats, colour: Floats, met: Sequence[SurfaceHit]
) -> None:
    """Composite a slab behind the pixels: its surfaces at their positions, and between them its uniform absorption.

    Parameters
    ----------
    depth, colour : float64 (m,), (m, 3), optical depth and colour of the whole slab
    met : surfaces of the slab
    """
    places = np.array([one.place for one in met]).reshape(-1, len(depth))
    order = np.argsort(places, axis=0, kind="stable")
    alphas = np.array([one.opacity for one in met]).reshape(-1, len(depth))
    colours = np.array([one.colour for one in met]).reshape(-1, len(depth), 3)
    begin, pixel = slab.begin, np.arange(len(depth))
    for which in order:
        place = np.clip(places[which, pixel], slab.begin, slab.end)
        _absorb(rgba, transmittance, slab.rays, depth * (place - begin) / (slab.end - slab.begin), colour)
        alpha = alphas[which, pixel]
        weight = transmittance[slab.rays] * alpha
        rgba[slab.rays] += weight[:, None] * np.column_stack([colours[which, pixel], np.ones(len(depth))])
        transmittance[slab.rays] *= 1 - alpha
        begin = place
    _absorb(rgba, transmittance, slab.rays, depth * (slab.end - begin) / (slab.end - slab.begin), colour)


def _absorb(rgba: Floats, transmittance: Floats, rays: NDArray[np.int64], depth: Floats, colour: Floats) -> None:
    weight = transmittance[rays] * -np.expm1(-depth)
    rgba[rays, :3] += weight[:, None] * colour
    rgba[rays, 3] += weight
    transmittance[rays] *= np.exp(-depth)
