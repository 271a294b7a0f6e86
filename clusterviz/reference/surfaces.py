"""Reference of isosurfaces, alone or in a volume: every crossing of every ray (`crossings.py`), front to back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.reference.clipping import kept
from clusterviz.reference.crossings import RayField
from clusterviz.reference.fields import SAMPLERS, gradient_at
from clusterviz.reference.grading import needs_gradient, optics
from clusterviz.reference.lighting import lit
from clusterviz.reference.rays import Floats, Rays
from clusterviz.reference.slabs import slabs
from clusterviz.scene.complete import transfer_function
from clusterviz.scene.values import Scene


def march_surfaces(rays: Rays, voxels: NDArray[Any], length: float, scene: Scene, grid: Grid) -> Floats:
    """Return the colours of rays, (n, 4).

    The surfaces of a slab are all of its crossings. In a composited volume the parts of a slab before, between and
    behind its surfaces absorb light as its midpoint does.
    """
    volume = scene.volumes[0]
    classify, sample = transfer_function(volume), SAMPLERS[volume.interpolation]
    wanted = sorted(
        (entry if isinstance(entry, tuple) else (entry, float(classify.opacity(entry)))) for entry in volume.isosurfaces
    )
    rgba = np.zeros((len(rays.direction), 4))

    def absorb(pixels: NDArray[np.int64], alpha: Floats, colour: Floats) -> None:
        share = (1 - rgba[pixels, 3:]) * alpha[:, None]
        rgba[pixels] += share * np.append(colour, np.ones((len(pixels), 1)), axis=1)

    def gradients(point: Floats) -> Floats | None:
        return gradient_at(volume, voxels, point) if needs_gradient(volume) else None

    def lit_up(
        colour: Floats, gradient: Floats | None, point: Floats, pixels: NDArray[np.int64], box: tuple[int, ...] = ()
    ) -> Floats:
        if gradient is None or not volume.shade:
            return colour
        return lit(colour, gradient, point, rays.direction[pixels], volume, scene, grid, box)

    course = RayField(rays, voxels, volume.interpolation, np.array([value for value, _ in wanted]))
    opacities, colours = (np.array([entry[1] for entry in wanted]), classify.colour(np.array([v for v, _ in wanted])))
    for slab in slabs(rays, voxels.shape, length, lambda: rgba[:, 3] < 1):
        middle, known = sample(voxels, *slab.point.T)
        known &= kept(slab.point, scene.clip, grid) & (volume.blending == "composite")
        gradient = gradients(slab.point)
        glow, extinction = optics(volume, classify, middle, gradient, grid)
        glow, extinction = lit_up(glow, gradient, slab.point, slab.rays, voxels.shape), np.where(known, extinction, 0)
        begin = slab.begin.copy()
        for met in course.crossings(slab.rays, slab.begin, slab.end):
            here, pixels = met.slabs, slab.rays[met.slabs]
            absorb(pixels, -np.expm1(-extinction[here] * (met.place - begin[here])), glow[here])
            begin[here] = met.place
            point = rays.start[pixels] + met.place[:, None] * rays.direction[pixels]
            colour = lit_up(colours[met.surface], gradients(met.inside), point, pixels)
            absorb(pixels, np.where(kept(point, scene.clip, grid), opacities[met.surface], 0), colour)
        absorb(slab.rays, -np.expm1(-extinction * (slab.end - begin)), glow)
    return rgba
