"""The witness's light: gradients by differences of voxels, and Phong's model on both sides of a surface, as in VTK."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.reference.rays import Floats
from clusterviz.reference.sample import Flags, nearest_voxel, trilinear_cell
from clusterviz.scene.light import Light
from clusterviz.scene.values import Volume


def trilinear_gradient(voxels: NDArray[Any], point: Floats) -> Floats:
    """Derivatives at voxels by second-order differences, interpolated linearly; per voxel.

    Differences are central, and one-sided where a neighbour lies outside of the volume or is invalid.

    Parameters
    ----------
    voxels : (z, y, x)
    point : float64 (n, 3), (x, y, z) in samples, inside the box, in cells without an invalid corner

    Returns
    -------
    gradient : float64 (n, 3), (x, y, z); anything where a corner is invalid
    """
    cell, fraction = trilinear_cell(voxels, point)
    gradient = np.zeros(point.shape)
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, fraction, 1 - fraction).prod(axis=1)
        gradient += weight[:, None] * _slopes(voxels, cell + corner, curved=True)
    return gradient


def nearest_gradient(voxels: NDArray[Any], point: Floats) -> Floats:
    """Differences at the nearest voxel: central, or to its only neighbour; otherwise as `trilinear_gradient`."""
    return _slopes(voxels, nearest_voxel(voxels, point), curved=False)


def lit(
    colour: Floats,
    gradient: Floats,
    point: Floats,
    ray: Floats,
    volume: Volume,
    lights: Sequence[Light],
    grid: Grid,
) -> Floats:
    """Straight colours under the scene's lights, cut at 1.

    Parameters
    ----------
    colour : float64 (n, 3)
    gradient : float64 (n, 3), per voxel along (x, y, z)
    point : float64 (n, 3), (x, y, z) in samples
    ray : float64 (n, 3), the ray's direction in index space
    volume : its material
    lights : of the scene; none is a headlight

    References
    ----------
    B. T. Phong: Illumination for computer generated pictures, CACM 18(6), 1975.
    """
    world_from_index = grid.world_from_index[:3, :3]
    normal = _unit(_unit(gradient) @ np.linalg.inv(world_from_index / np.abs(world_from_index).max()))
    toward_eye = -_unit(ray @ world_from_index.T)
    found = volume.ambient * colour
    for light in lights or (Light(type="headlight"),):
        toward_light = toward_eye
        if light.position is not None and light.type == "scene":
            toward_light = np.broadcast_to(_unit(np.subtract(light.position, light.focal_point)[None]), normal.shape)
        strength = np.full(normal.shape, light.intensity) * light.color
        if light.position is not None and light.positional:
            way = light.position - (point @ world_from_index.T + grid.origin)
            toward_light = _unit(way)
            strength = strength * _arriving(light, way)[:, None]
        facing = (normal * toward_light).sum(axis=1, keepdims=True)
        mirror = 2 * facing * normal - toward_light
        highlight = np.maximum((mirror * toward_eye).sum(axis=1, keepdims=True), 0) ** volume.specular_power
        found = found + volume.diffuse * np.abs(facing) * strength * colour
        found = found + volume.specular * np.where(facing != 0, highlight, 0) * strength
    return np.minimum(found, 1)


def _arriving(light: Light, way: Floats) -> Floats:
    """What share of a positional light arrives over the way (n, 3) to it."""
    distance = np.linalg.norm(way, axis=1)
    constant, linear, square = light.attenuation
    share = 1 / (constant + linear * distance + square * distance**2)
    if light.has_cone and light.position is not None:
        along = _unit(way) @ _unit(np.subtract(light.position, light.focal_point)[None])[0]
        inside = along >= np.cos(np.radians(light.cone_angle))
        share = share * np.where(inside, np.maximum(along, 0) ** light.exponent, 0)
    found: Floats = share
    return found


def _slopes(voxels: NDArray[Any], at: NDArray[np.int64], curved: bool) -> Floats:
    """Derivatives (n, 3) at voxels (x, y, z): central differences, one-sided where a neighbour is missing or invalid.

    One-sided differences are those of the parabola through three voxels, or, where the third is missing or not
    `curved`, of the line through two; 0 where there is no neighbour at all.
    """
    found = np.zeros(at.shape)
    for axis in range(3):
        (below, has_below), (here, _), (above, has_above) = (_beside(voxels, at, axis, k) for k in (-1, 0, 1))
        found[:, axis] = np.where(has_below & has_above, _half(below, above), 0)
        for sign, near, alone in ((1, above, has_above & ~has_below), (-1, below, has_below & ~has_above)):
            far, has_far = _beside(voxels, at, axis, 2 * sign)
            with np.errstate(over="ignore", invalid="ignore"):
                line = 2 * _half(here, near)
                parabola = 2 * line - _half(here, far)
            found[:, axis] = np.where(alone, sign * np.where(has_far & curved, parabola, line), found[:, axis])
    return np.nan_to_num(found)  # what overflows is as steep as can be


def _beside(voxels: NDArray[Any], at: NDArray[np.int64], axis: int, distance: int) -> tuple[Floats, Flags]:
    """The voxels (n,) so far along an axis, 0 where there is none; and where there is one that is valid."""
    place = at.copy()
    place[:, axis] += distance
    inside = (place[:, axis] >= 0) & (place[:, axis] < voxels.shape[2 - axis])
    value = voxels[tuple(np.where(inside[:, None], place, at)[:, ::-1].T)].astype(np.float64)
    valid: Flags = inside & np.isfinite(value)
    return np.where(valid, value, 0), valid


def _half(low: Floats, high: Floats) -> Floats:
    """(high − low) / 2; the other form where the difference overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        half: Floats = (high - low) / 2
    return np.where(np.isfinite(half), half, high / 2 - low / 2)


def _unit(vectors: Floats) -> Floats:
    """At length 1; the zero vector stays."""
    largest = np.abs(vectors).max(axis=1, keepdims=True)
    scaled = vectors / np.where(largest > 0, largest, 1)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    unit: Floats = scaled / np.where(length > 0, length, 1)
    return unit
