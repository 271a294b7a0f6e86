"""The witness's light: gradients by central differences, and Phong's model on both sides of a surface, as in VTK."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.reference.rays import Floats
from clusterviz.reference.sample import nearest_voxel, trilinear_cell
from clusterviz.scene.light import Light
from clusterviz.scene.values import Volume


def trilinear_gradient(voxels: NDArray[Any], point: Floats) -> Floats:
    """Central differences of voxels, interpolated linearly; per voxel.

    A voxel outside of the volume, or an invalid one, is replaced by the corner of the cell beside it.

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
        gradient += weight[:, None] * _differences(voxels, cell + corner)
    return gradient


def nearest_gradient(voxels: NDArray[Any], point: Floats) -> Floats:
    """Central differences at the nearest voxel; otherwise as `trilinear_gradient`."""
    return _differences(voxels, nearest_voxel(voxels, point))


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


def _differences(voxels: NDArray[Any], at: NDArray[np.int64]) -> Floats:
    """Central differences (n, 3) at voxels (x, y, z); a neighbour that is missing or invalid is the voxel itself."""
    last = np.array(voxels.shape[::-1]) - 1
    found = np.zeros(at.shape)
    for axis in range(3):
        sides = []
        for sign in (-1, 1):
            beside = at.copy()
            beside[:, axis] = np.clip(at[:, axis] + sign, 0, last[axis])
            value = voxels[tuple(beside[:, ::-1].T)].astype(np.float64)
            sides.append(np.where(np.isfinite(value), value, voxels[tuple(at[:, ::-1].T)]))
        found[:, axis] = np.where(np.isfinite(sides).all(axis=0), _half(sides[0], sides[1]), 0)
    return found


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
