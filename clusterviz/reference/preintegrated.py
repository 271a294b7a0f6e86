"""Reference of pre-integrated classification: slabs along which the scalar changes linearly.

It uses no tables: each slab is cut at the control points of the transfer function, and each piece, which is smooth, is
integrated by Gaussian quadrature, with attenuation.

References
----------
K. Engel, M. Kraus, T. Ertl: High-quality pre-integrated volume rendering using hardware-accelerated pixel shading,
Graphics Hardware 2001, section 3.1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.ambient_occlusion import ambient_light
from clusterviz.reference.fields import SAMPLERS, gradient_at
from clusterviz.reference.grading import fading, magnitude_of, needs_gradient
from clusterviz.reference.layers import HalfOpacity, gradient_normals
from clusterviz.reference.lighting import lit
from clusterviz.reference.rays import Floats, Rays, inside, kept
from clusterviz.reference.slabs import in_brick, pieces_of, slabs
from clusterviz.reference.transfer import TransferFunction, transfer_function
from clusterviz.scene.values import Scene

NODES = (np.polynomial.legendre.leggauss(8)[0] + 1) / 2
WEIGHTS = np.polynomial.legendre.leggauss(8)[1] / 2
ENDS = np.array([0.0, 1.0])
# More cuts of nearly opaque slabs, of which little is visible behind the front.
FINE = np.concatenate([ENDS, np.arange(1, 16) / 16, 2.0 ** -np.arange(5, 13)])
NEARER = 4.0 ** -np.arange(1, 13)
# Matrix from values at the nodes to integrals from 0 to each node, exact for polynomials through 8 nodes.
POWERS = np.arange(8)
TO_NODES = (NODES[:, None] ** (POWERS + 1) / (POWERS + 1)) @ np.linalg.inv(NODES[:, None] ** POWERS)


def march_preintegrated(
    rays: Rays, voxels: NDArray[Any], length: float, scene: Scene, grid: Grid, met: HalfOpacity | None = None
) -> Floats:
    """Return the colours of rays, (n, 4).

    The midpoint of a slab decides whether it is clipped. With `quality.borders: split` slabs are cut at the faces of
    bricks of `cluster.brick` cells, and a part uses only the cells of its own brick. Each part has the light of its
    midpoint. An end without a scalar has the midpoint's; a part whose midpoint has none either is transparent.
    Rays begin and end inside the volume by 10⁻¹³ of their length, so that of cells that meet at an end, the one that
    the ray runs through decides whether there is a scalar. `met` is written.
    """
    volume = scene.volumes[0]
    classify, sample = transfer_function(volume), SAMPLERS[volume.interpolation]
    rgba = np.zeros((len(rays.direction), 4))
    transmittance = np.ones(len(rgba))
    brick = scene.cluster.brick if scene.quality.borders == "split" else None
    entry, leave = inside(rays, np.array(voxels.shape[::-1]) - 1.0)
    hair = 1e-13 * np.where(leave > entry, leave - entry, 0)
    for slab in slabs(rays, voxels.shape, length, lambda: transmittance > 2.0**-60):
        whole = kept(slab.point, scene.clip, grid)
        start, direction = rays.start[slab.rays], rays.direction[slab.rays]
        for part in pieces_of(slab, rays, voxels.shape, brick):
            middle, known = sample(voxels, *part.point.T)
            times = np.maximum(part.begin, (entry + hair)[slab.rays]), np.minimum(part.end, (leave - hair)[slab.rays])
            places = (in_brick(start + t[:, None] * direction, part.point, brick) for t in times)
            ends = [sample(voxels, *place.T) for place in places]
            front, back = (np.where(valid, scalar, middle) for scalar, valid in ends)
            seen = (known | (ends[0][1] & ends[1][1])) & whole
            way = np.where(seen, part.end - part.begin, 0)
            gradient = gradient_at(volume, voxels, part.point) if needs_gradient(volume) else None
            if gradient is not None:
                gradient = np.where(known[:, None], gradient, 0)
            if gradient is not None and volume.gradient_opacity:
                way = way * fading(volume, magnitude_of(gradient, grid))
            colour, depth = integrate(classify, front, back, way)
            if met:
                ends_of, normals = (part.begin, part.end), gradient_normals(part.point, (volume, voxels, grid))
                met.take(slab.rays, transmittance[slab.rays], depth, ends_of, 0, normals)
            alpha = -np.expm1(-depth)
            if volume.shade and gradient is not None:
                straight = colour / np.where(alpha > 0, alpha, 1)[:, None]
                ambient = ambient_light(volume, voxels, part.point, scene, grid)
                light = lit(straight, gradient, part.point, direction, volume, scene, grid, voxels.shape, ambient)
                colour = light * alpha[:, None]
            rgba[slab.rays, :3] += transmittance[slab.rays, None] * colour
            rgba[slab.rays, 3] += transmittance[slab.rays] * alpha
            transmittance[slab.rays] *= np.exp(-depth)
    return rgba


def integrate(
    classify: TransferFunction, front: Floats, back: Floats, length: Floats, attenuated: bool = True
) -> tuple[Floats, Floats]:
    """Return emission and optical depth of slabs along which the scalar changes linearly from front to back.

    Parameters
    ----------
    front, back, length : float64 (n,)
    attenuated : whether emission is attenuated within the slab; else the integral of κc is returned

    Returns
    -------
    colour : float64 (n, 3), premultiplied
    depth : float64 (n,)
    """
    # Less than they are where a difference of two scalars overflows.
    small = 1.0 if np.abs([front, back]).max(initial=0.0) < 4e307 else 0.25
    knots, front, span = small * _knots(classify), small * front, small * back - small * front
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        met = np.clip((knots - front[:, None]) / span[:, None], 0, 1)
    met = np.where((span == 0)[:, None], 0, met)
    most = length.max(initial=0.0) * classify.extinction(classify.opacity_values).max()
    more = np.broadcast_to(FINE if most > 1 else ENDS, (len(front), len(FINE if most > 1 else ENDS)))
    cuts = np.sort(np.concatenate([met, more], axis=1), axis=1)
    colour, depth = np.zeros((len(front), 3)), np.zeros(len(front))
    for begin, end in zip(cuts.T[:-1], cuts.T[1:], strict=True):
        some = np.flatnonzero((end > begin) & (length > 0))
        share = begin[some, None] + (end - begin)[some, None] * NODES
        scalar = (front[some, None] + share * span[some, None]) / small
        kappa = classify.extinction(scalar) * ((end - begin) * length)[some, None]
        before = depth[some, None] + kappa @ TO_NODES.T
        light = kappa * WEIGHTS * (np.exp(-before) if attenuated else 1.0)
        colour[some] += np.einsum("nk,nkc->nc", light, classify.colour(scalar))
        depth[some] += kappa @ WEIGHTS
    return colour, depth


def _knots(classify: TransferFunction) -> Floats:
    """Return the scalars between which colour and extinction are smooth, denser near full opacity."""
    values, steep = classify.opacity_values, np.zeros(0)
    for at in np.flatnonzero(classify.opacities > 0.95).tolist():
        for beside in (values[max(at - 1, 0)], values[min(at + 1, len(values) - 1)]):
            steep = np.append(steep, values[at] + (beside - values[at]) * NEARER)
    return np.unique(np.concatenate([classify.colour_values, values, steep]))
