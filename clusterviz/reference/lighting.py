"""Reference of lighting: gradients by differences of voxels, and two-sided Phong shading as in VTK."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.reference.rays import Floats
from clusterviz.reference.sample import Flags, cubic, cubic_gradient, nearest, nearest_voxel, trilinear, trilinear_cell
from clusterviz.reference.transfer import transfer_function
from clusterviz.scene.values import Clip, Light, Scene, Volume


class Material(Protocol):
    """Shares of the light that a volume or a surface reflects."""

    @property
    def ambient(self) -> float: ...

    @property
    def diffuse(self) -> float: ...

    @property
    def specular(self) -> float: ...

    @property
    def specular_power(self) -> float: ...


CAP_UNITS, CAP_STEEP, FACE_STEEP = 4.0, 1 / 4, 1 / 128


def trilinear_gradient(voxels: NDArray[Any], point: Floats) -> Floats:
    """Return derivatives at voxels by second-order differences, interpolated linearly; per voxel.

    Differences are central, and one-sided where a neighbour lies outside of the volume or is invalid.

    `voxels`: (z, y, x); `point`: float64 (n, 3), (x, y, z) in samples, inside the box, in cells without an invalid
    corner. Returns float64 (n, 3), (x, y, z); undefined where a corner is invalid.
    """
    cell, fraction = trilinear_cell(voxels, point)
    corners = np.array(list(np.ndindex(2, 2, 2)))[:, None]
    slopes = _slopes(voxels, (cell + corners).reshape(-1, 3), curved=True).reshape(8, *point.shape)
    weights = np.where(corners, fraction, 1 - fraction).prod(axis=2, keepdims=True)
    gradient: Floats = (weights * slopes).sum(axis=0)
    return gradient


def nearest_gradient(voxels: NDArray[Any], point: Floats) -> Floats:
    """Return differences at the nearest voxel: central, or to its only neighbour; otherwise as `trilinear_gradient`."""
    return _slopes(voxels, nearest_voxel(voxels, point), curved=False)


def lit(
    colour: Floats,
    gradient: Floats,
    point: Floats,
    ray: Floats,
    volume: Material,
    scene: Scene,
    grid: Grid,
    box: tuple[int, ...] = (),
    ambient: Floats | float | None = None,
) -> Floats:
    """Return straight colours under the scene's lights, clamped to 1.

    Samples next to a plane that cuts the volume, or to a face of the volume, are lit with the plane's normal. Its
    weight falls from 1 to 0 over `CAP_UNITS` opacity unit distances behind the plane, and with the gradient's magnitude
    up to `CAP_STEEP`, or, at the volume's faces, `FACE_STEEP`. Of several planes the one with the largest weight is
    used.

    Reference: B. T. Phong: Illumination for computer generated pictures, CACM 18(6), 1975.

    Parameters
    ----------
    colour : float64 (n, 3)
    gradient : float64 (n, 3), per voxel along (x, y, z)
    point : float64 (n, 3), (x, y, z) in samples
    ray : float64 (n, 3), the ray's direction in index space
    volume : its material
    scene : for its lights, none being a headlight, and its clipping
    box : samples of the volume along z, y, x, whose cut faces are lit as such; () for surfaces, which have none
    ambient : share of the ambient light that arrives, see `ambient_light`; default: the volume's
    """
    world_from_index = grid.world_from_index[:3, :3]
    normal = unit(unit(gradient) @ np.linalg.inv(world_from_index / np.abs(world_from_index).max()))
    toward_eye = -unit(ray @ world_from_index.T)
    share, cap = (
        _cap(gradient, point, volume, scene.clip, grid, box)
        if box and scene.clip.cap and isinstance(volume, Volume)
        else (np.zeros(len(point)), normal)
    )
    found = (volume.ambient if ambient is None else ambient) * colour
    for toward_light, strength in _lights(scene, point @ world_from_index.T + grid.origin, toward_eye):
        for one, weight in ((normal, 1 - share), (cap, share)):
            facing = (one * toward_light).sum(axis=1, keepdims=True)
            mirror = 2 * facing * one - toward_light
            highlight = np.maximum((mirror * toward_eye).sum(axis=1, keepdims=True), 0) ** volume.specular_power
            reflected = volume.diffuse * np.abs(facing) * colour + volume.specular * np.where(facing != 0, highlight, 0)
            found = found + weight[:, None] * reflected * strength
    return np.minimum(found, 1)


def lit_line(
    colour: Floats, vector: Floats, point: Floats, ray: Floats, volume: Material, scene: Scene, grid: Grid
) -> Floats:
    """Return straight colours of thin lines under the scene's lights, clamped to 1.

    Of all normals of a line, the one that lies in a plane with the light reflects most diffusely, and the one between
    light and eye most specularly. Without a direction a line reflects as much as one across the light.

    Reference: M. Zöckler, D. Stalling, H.-C. Hege: Interactive visualization of 3D-vector fields using illuminated
    stream lines, IEEE Visualization 1996, section 3.

    `vector`: float64 (n, 3), along the lines, in the world; `colour`, `point`, `ray`, `volume`, `scene`, `grid`: as in
    `lit`.
    """
    world_from_index = grid.world_from_index[:3, :3]
    tangent, toward_eye = unit(vector), -unit(ray @ world_from_index.T)
    found = volume.ambient * colour
    for toward_light, strength in _lights(scene, point @ world_from_index.T + grid.origin, toward_eye):
        angles = [np.arccos(np.clip((tangent * one).sum(axis=1), -1, 1)) for one in (toward_light, toward_eye)]
        # The mirrored light leaves at the same angle on the other side.
        mirrored = np.maximum(np.cos(np.pi - angles[0] - angles[1]), 0) ** volume.specular_power
        reflected = volume.diffuse * np.sin(angles[0])[:, None] * colour + (volume.specular * mirrored)[:, None]
        found = found + reflected * strength
    return np.minimum(found, 1)


def _lights(scene: Scene, places: Floats, toward_eye: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Yield the directions to each light from places in the world, and what arrives of it, (n, 3) each."""
    for light in scene.lights or (Light(type="headlight"),):
        toward_light, strength = toward_eye, np.full(places.shape, light.intensity) * light.color
        if light.position is not None and light.type == "scene":
            toward_light = np.broadcast_to(unit(np.subtract(light.position, light.focal_point)[None]), places.shape)
        if light.position is not None and light.positional:
            toward_light = unit(light.position - places)
            strength = strength * _arriving(light, light.position - places)[:, None]
        yield toward_light, strength


def _cap(
    gradient: Floats, point: Floats, volume: Volume, clip: Clip, grid: Grid, box: tuple[int, ...]
) -> tuple[Floats, Floats]:
    """Return the weight (n,) of a cut face's light, and the face's unit normal (n, 3) in the world."""
    transfer, index_from_world = transfer_function(volume), np.linalg.inv(grid.world_from_index[:3, :3])
    low, high = transfer.domain
    scale = np.abs(index_from_world).max()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        width = high - low if np.isfinite(high - low) else high
        units = gradient / max(width, np.finfo(np.float64).smallest_subnormal)
        slope = units @ (index_from_world / scale) * (min(grid.spacing) * scale)
        steep = np.nan_to_num(np.linalg.norm(slope, axis=1), nan=np.inf)
    world = point @ grid.world_from_index[:3, :3].T + grid.origin
    planes = [(np.array(origin), np.array(normal), CAP_STEEP) for origin, normal in clip.planes]
    corners = [np.array(grid.origin), grid.world_from_index[:3, :3] @ (np.array(box[::-1]) - 1) + grid.origin]
    for axis in range(3):
        planes += [
            (corner, sign * index_from_world[axis], FACE_STEEP) for corner, sign in zip(corners, (1, -1), strict=True)
        ]
        if clip.box is not None:
            sides = clip.box[2 * axis : 2 * axis + 2]
            planes += [
                (np.full(3, side), sign * np.eye(3)[axis], CAP_STEEP) for side, sign in zip(sides, (1, -1), strict=True)
            ]
    share, cap = np.zeros(len(point)), np.zeros(point.shape)
    for origin, normal, least in planes:
        unit = normal / np.linalg.norm(normal)
        behind = (world - origin) @ unit / (CAP_UNITS * transfer.unit_distance)
        found = np.maximum(1 - steep / least, 0) * np.clip(1 - behind, 0, 1)
        cap = np.where((found > share)[:, None], unit, cap)
        share = np.maximum(found, share)
    return share, cap


def _arriving(light: Light, way: Floats) -> Floats:
    """Return the fraction of a positional light that arrives over the way (n, 3) to it."""
    distance = np.linalg.norm(way, axis=1)
    constant, linear, square = light.attenuation
    share = 1 / (constant + linear * distance + square * distance**2)
    if light.has_cone and light.position is not None:
        along = unit(way) @ unit(np.subtract(light.position, light.focal_point)[None])[0]
        inside = along >= np.cos(np.radians(light.cone_angle))
        share = share * np.where(inside, np.maximum(along, 0) ** light.exponent, 0)
    found: Floats = share
    return found


def _slopes(voxels: NDArray[Any], at: NDArray[np.int64], curved: bool) -> Floats:
    """Return derivatives (n, 3) at voxels (x, y, z): central, one-sided where a neighbour is missing or invalid.

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
    return np.nan_to_num(found)  # overflow counts as the largest slope


def _beside(voxels: NDArray[Any], at: NDArray[np.int64], axis: int, distance: int) -> tuple[Floats, Flags]:
    """Return the voxels (n,) at a distance along an axis, 0 where there is none; and where there is a valid one."""
    place, along = at.copy(), at[:, axis] + distance
    inside = (along >= 0) & (along < voxels.shape[2 - axis])
    place[inside, axis] = along[inside]
    value = voxels[tuple(place[:, ::-1].T)].astype(np.float64)
    valid: Flags = inside & np.isfinite(value)
    return np.where(valid, value, 0), valid


def _half(low: Floats, high: Floats) -> Floats:
    """Return (high − low) / 2; the other form where the difference overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        half: Floats = (high - low) / 2
    return np.where(np.isfinite(half), half, high / 2 - low / 2)


def unit(vectors: Floats) -> Floats:
    """Return unit vectors; the zero vector stays."""
    largest = np.abs(vectors).max(axis=1, keepdims=True)
    scaled = vectors / np.where(largest > 0, largest, 1)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    unit: Floats = scaled / np.where(length > 0, length, 1)
    return unit


SAMPLERS = {"linear": trilinear, "nearest": nearest, "cubic": cubic}
_GRADIENTS = {"linear": trilinear_gradient, "nearest": nearest_gradient, "cubic": cubic_gradient}


def gradient_at(volume: Volume, voxels: NDArray[Any], point: Floats) -> Floats:
    """Return the gradient by which a volume is lit, float64 (n, 3), per voxel along (x, y, z)."""
    kernel = cubic_gradient if volume.gradient == "smooth" else _GRADIENTS[volume.interpolation]
    return kernel(voxels, point)
