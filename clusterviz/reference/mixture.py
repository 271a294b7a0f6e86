"""The witness of several volumes in one scene: emission and absorption of their mixture, slab by slab.

Rays are cut into slabs in the axis-aligned box around all volumes. A slab lies in every volume that holds its midpoint;
there the extinctions add up, κ = Σ κ_i, and its colour is that of the particles in it: Σ κ_i c_i / Σ κ_i. What is
classified between the ends of slabs, and isosurfaces, are said in `ingredients.py`.

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
from clusterviz.reference.ingredients import Body, Met, Passage, has_ends
from clusterviz.reference.rays import Floats, Rays, to_index_space
from clusterviz.reference.slabs import Slab, slabs_in
from clusterviz.scene.values import Scene

DARK = 2.0**-60
LONGEST = 2.0
"""Of a slab, in the smallest spacing, where anything depends on the field at its ends."""


def march_mixture(rays: Rays, bodies: Sequence[Body], step: float, scene: Scene) -> Floats:
    """The colours of some rays, float64 (n, 4), premultiplied.

    Parameters
    ----------
    rays : in the world
    bodies : the volumes, in any order: a mixture has none
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
    passages = [Passage(rays, body, scene) for body in bodies if body.has_extent]
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


def _pass(rgba: Floats, transmittance: Floats, slab: Slab, depth: Floats, colour: Floats, met: Sequence[Met]) -> None:
    """Add a slab behind what the pixels hold: its surfaces by their places, and between them its depth, spread evenly.

    Parameters
    ----------
    depth, colour : float64 (m,), (m, 3), of the whole slab
    met : its surfaces
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
