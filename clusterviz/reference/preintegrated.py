"""Reference of pre-integrated classification: slabs along which the scalar changes linearly.

It uses no tables: each slab is cut at the control points of the transfer function, and each piece, which is smooth, is
integrated by Gaussian quadrature, with attenuation.

Reference: K. Engel, M. Kraus, T. Ertl: High-quality pre-integrated volume rendering using hardware-accelerated pixel
shading, Graphics Hardware 2001, section 3.1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.ambient_occlusion import lit_volume
from clusterviz.reference.grading import fading, magnitude_of, needs_gradient
from clusterviz.reference.layers import Field, HalfOpacity, gradient_normals
from clusterviz.reference.lighting import SAMPLERS, gradient_at
from clusterviz.reference.rays import Floats, Rays, inside, kept
from clusterviz.reference.sample import Flags
from clusterviz.reference.slabs import in_brick, pieces_of, slabs
from clusterviz.reference.transfer import TransferFunction, transfer_function
from clusterviz.scene.values import Scene, Volume

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
    classify = transfer_function(volume)
    rgba = np.zeros((len(rays.direction), 4))
    transmittance = np.ones(len(rgba))
    brick = scene.cluster.brick if scene.quality.borders == "split" else None
    entry, leave = inside(rays, np.array(voxels.shape[::-1]) - 1.0)
    hair = 1e-13 * np.where(leave > entry, leave - entry, 0)
    for slab in slabs(rays, voxels.shape, length, lambda: transmittance > 2.0**-60):
        whole = kept(slab.point, scene.clip, grid)
        start, direction = rays.start[slab.rays], rays.direction[slab.rays]
        for part in pieces_of(slab, rays, voxels.shape, brick):
            times = np.maximum(part.begin, (entry + hair)[slab.rays]), np.minimum(part.end, (leave - hair)[slab.rays])
            front, back = (in_brick(start + t[:, None] * direction, part.point, brick) for t in times)
            places, way = (front, part.point, back), part.end - part.begin
            colour, depth, gradient = ramp((volume, voxels, grid), classify, places, way, whole)
            if met:
                ends_of, normals = (part.begin, part.end), gradient_normals(part.point, (volume, voxels, grid))
                met.take(slab.rays, transmittance[slab.rays], depth, ends_of, 0, normals)
            alpha = -np.expm1(-depth)
            if volume.shade:
                straight = colour / np.where(alpha > 0, alpha, 1)[:, None]
                field = volume, voxels, grid
                light = lit_volume(field, scene, straight, gradient, part.point, direction, voxels.shape)
                colour = light * alpha[:, None]
            rgba[slab.rays, :3] += transmittance[slab.rays, None] * colour
            rgba[slab.rays, 3] += transmittance[slab.rays] * alpha
            transmittance[slab.rays] *= np.exp(-depth)
    return rgba


def is_ramped(volume: Volume, scene: Scene) -> bool:
    """Return whether classification is pre-integrated; nearest voxels have no linear scalars."""
    has_ramps = volume.interpolation != "nearest" and not (volume.isosurfaces or volume.transfer_2d or volume.shader)
    return scene.quality.classification == "pre-integrated" and volume.blending == "composite" and has_ramps


def ramp(
    field: Field,
    classify: TransferFunction,
    places: Sequence[Floats],
    way: Floats,
    seen: Flags,
    attenuated: bool = True,
) -> tuple[Floats, Floats, Floats | None]:
    """Return emission, optical depth and gradients (n, 3), if any are needed, of slabs with a linear scalar.

    An end without a scalar has that of the middle; without it, or where a slab is not seen, it is transparent.

    `places`: begin, middle and end of the slabs, (n, 3), in samples; `way`: float64 (n,), their lengths in the world.
    """
    volume, voxels, grid = field
    (front, has_front), (middle, known), (back, has_back) = (
        SAMPLERS[volume.interpolation](voxels, *place.T) for place in places
    )
    way = np.where(seen & (known | (has_front & has_back)), way, 0)
    gradient = gradient_at(volume, voxels, places[1]) if needs_gradient(volume) else None
    if gradient is not None:
        gradient = np.where(known[:, None], gradient, 0)
        if volume.gradient_opacity:
            way = way * fading(volume, magnitude_of(gradient, grid))
    ends = np.where(has_front, front, middle), np.where(has_back, back, middle)
    return *integrate(classify, *ends, way, attenuated), gradient


def integrate(
    classify: TransferFunction, front: Floats, back: Floats, length: Floats, attenuated: bool = True
) -> tuple[Floats, Floats]:
    """Return emission and optical depth of slabs along which the scalar changes linearly from front to back.

    `front`, `back`, `length`: float64 (n,). `attenuated`: whether emission is attenuated within the slab; else the
    integral of κc is returned. Returns `colour`, float64 (n, 3), premultiplied; `depth`, float64 (n,).
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
