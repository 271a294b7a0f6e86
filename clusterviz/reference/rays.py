"""Reference rays in float64: the ray of each pixel, and its part in the volume."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.scene.values import Camera, Clip, Scene

Floats = NDArray[np.float64]


class Columns:
    """Base of dataclasses whose fields are arrays of one length."""

    def some(self, chosen: NDArray[Any]) -> Self:
        """Return the rows of a mask, or with some numbers."""
        return type(self)(*(getattr(self, one.name)[chosen] for one in fields(self)))  # type: ignore[arg-type]

    def joined(self, parts: Sequence[Self]) -> Self:
        """Return the rows of this and of parts behind it."""
        names = [one.name for one in fields(self)]  # type: ignore[arg-type]
        return type(self)(*(np.concatenate([getattr(one, name) for one in (self, *parts)]) for name in names))


@dataclass(frozen=True)
class Rays:
    """One ray per pixel, in pixel order (row 0 on top): start + t · direction, t in world length."""

    start: Floats  # float64 (n, 3), (x, y, z): the eye, or for parallel projection a point of the plane through it
    direction: Floats  # float64 (n, 3); of unit length in the world
    # float64 (n,) or one for all: fraction of a slab by which the first one begins before the volume
    shift: Floats | float = 0.0
    thickness: Floats | float = 1.0  # float64 (n,) or one for all: length of a slab over the longest one of all rays


def camera_rays(camera: Camera, size: tuple[int, int], lens_point: Sequence[float] = (0.0, 0.0)) -> Rays:
    """Return the rays through the centres of all pixels, in the world, by VTK's camera model.

    Raises InputError: the camera is not complete, position = focal_point, or view_up lies along the view direction.

    Parameters
    ----------
    camera : complete: position, focal_point and view_up are given
    size : (width, height) in pixels; pixels are square
    lens_point : to the right and up, in radii of the lens: where rays start; each meets its ray from the centre on the
        plane in focus
    """
    right, up, forward = camera_frame(camera)
    width, height = size
    column, row = np.arange(width), np.arange(height)
    # In units of half the picture's height, from the line of sight.
    shift_right, shift_up = camera.window_center
    across = ((2 * column + 1 - width) / height + shift_right * width / height)[None, :, None] * right
    upward = ((height - 2 * row - 1) / height + shift_up)[:, None, None] * up
    offset = (across + upward).reshape(-1, 3)
    eye = _given(camera.position, "position")
    if camera.parallel_scale is not None:
        return Rays(eye + offset * camera.parallel_scale, np.broadcast_to(forward, offset.shape))
    direction = forward + offset * math.tan(math.radians(camera.view_angle) / 2)
    if any(lens_point):
        focus = camera.focal_distance or math.dist(eye, _given(camera.focal_point, "focal_point"))
        aside = camera.aperture * (lens_point[0] * right + lens_point[1] * up)
        eye, direction = eye + aside, focus * direction - aside
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(np.broadcast_to(eye, offset.shape), direction)


def view_direction(camera: Camera) -> Floats:
    """Return the unit vector (3,) of a camera's view in the world; errors as of `camera_rays`."""
    return camera_frame(camera)[2]


def pixel_shifts(size: tuple[int, int]) -> Floats:
    """Return the jitter of every pixel, in pixel order: a hash of its column and row in [0, 1).

    Reference: C. Wellons: Prospecting for hash functions, 2018 (lowbias32).
    """

    def hashed(x: NDArray[np.uint32]) -> NDArray[np.uint32]:
        x = (x ^ (x >> np.uint32(16))) * np.uint32(0x7FEB352D)
        x = (x ^ (x >> np.uint32(15))) * np.uint32(0x846CA68B)
        return x ^ (x >> np.uint32(16))

    width, height = size
    column, row = np.arange(width, dtype=np.uint32), np.arange(height, dtype=np.uint32)
    shift: Floats = (hashed(hashed(column)[None, :] + row[:, None]) >> np.uint32(8)) / 2.0**24
    return shift.reshape(-1)


def on_slices(rays: Rays, directions: Floats, last: Floats, corners: Floats, length: float, scene: Scene) -> Rays:
    """Return rays whose slabs lie between planes perpendicular to the view direction.

    Parameters
    ----------
    rays : rays in the units of a box
    directions : float64 (n, 3), of the same rays in the world
    last : far corner (x, y, z) of the box [0, last] in its units
    corners : float64 (8, 3), the box's corners in the world; the planes begin at the nearest
    length : of a slab on the ray through the picture's corner, world units; on others slabs are shorter
    """
    camera, (width, height) = scene.camera, scene.image.size
    forward = view_direction(camera)
    cosines = directions @ forward
    half = 0.0 if camera.parallel_scale is not None else math.tan(math.radians(camera.view_angle) / 2)
    farthest = [1 + abs(shift) for shift in camera.window_center]
    distance = length / math.hypot(1.0, half * farthest[1], half * farthest[0] * width / height)
    front = ((corners - _given(camera.position, "position")) @ forward).min()
    entry = inside(rays, last)[0]
    passed = (np.where(np.isfinite(entry), entry, 0.0) * cosines - front) / distance
    return Rays(rays.start, rays.direction, passed - np.floor(passed), distance / (cosines * length))


def to_index_space(rays: Rays, grid: Grid) -> Rays:
    """Return rays in index space (x, y, z); t remains the world length."""
    world_from_index = grid.world_from_index[:3, :3]
    if np.linalg.matrix_rank(world_from_index / np.linalg.norm(world_from_index, axis=0)) < 3:
        raise InputError("the grid's axes lie in one plane", where="grid: direction", found=grid.direction)
    index_from_world = np.linalg.inv(world_from_index)
    start, direction = (rays.start - grid.origin) @ index_from_world.T, rays.direction @ index_from_world.T
    return Rays(start, direction, rays.shift, rays.thickness)


def inside(rays: Rays, last: Floats) -> tuple[Floats, Floats]:
    """Return the part [entry, exit] of each ray in the closed box [0, last] and not behind its start.

    Returns float64 (n,), exit ≤ entry where the ray misses the box.

    Reference: T. Kay, J. Kajiya: Ray tracing complex scenes, SIGGRAPH 1986 (slabs).

    `rays`: rays in index space; `last`: (x, y, z) of the last sample.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        to_first = (0 - rays.start) / rays.direction
        to_last = (last - rays.start) / rays.direction
    # A ray parallel to a pair of faces lies between them (the faces included) entirely or not at all.
    along = rays.direction == 0
    between = (rays.start >= 0) & (rays.start <= last)
    near = np.where(along, np.where(between, -np.inf, np.inf), np.minimum(to_first, to_last))
    far = np.where(along, np.where(between, np.inf, -np.inf), np.maximum(to_first, to_last))
    # Nothing behind the eye is visible, nor, in parallel projection, behind the plane through `position`. VTK does the
    # same: its near clipping plane is never behind the camera.
    return np.maximum(near.max(axis=1), 0), far.min(axis=1)


def camera_frame(camera: Camera) -> tuple[Floats, Floats, Floats]:
    """Return unit vectors to the right, up and forward."""
    forward = _unit(_given(camera.focal_point, "focal_point") - _given(camera.position, "position"), "position")
    view_up = _unit(_given(camera.view_up, "view_up"), "view_up")
    right = np.cross(forward, view_up)
    if not np.linalg.norm(right) > 1e-12:
        raise InputError("lies along the view direction", where="camera: view_up", found=camera.view_up)
    right /= np.linalg.norm(right)
    return right, np.cross(right, forward), forward


def _given(vector: tuple[float, float, float] | None, key: str) -> Floats:
    if vector is None:
        raise InputError("the camera is not complete", where=f"camera: {key}", found="nothing", allowed="[x, y, z]")
    return np.array(vector, np.float64)


def _unit(vector: Floats, key: str) -> Floats:
    largest = np.abs(vector).max()
    if not largest > 0:
        raise InputError("gives no direction", where=f"camera: {key}", found=vector.tolist())
    vector = vector / largest
    unit: Floats = vector / np.linalg.norm(vector)
    return unit


def kept(point: Floats, clip: Clip, grid: Grid) -> NDArray[np.bool_]:
    """Return which points are not clipped, bool (n,). `point`: float64 (n, 3), (x, y, z) in samples."""
    world = point @ grid.world_from_index[:3, :3].T + grid.origin
    found = np.ones(len(world), bool)
    for origin, normal in clip.planes:
        found &= (world - origin) @ np.array(normal) >= 0
    if clip.box is not None:
        low, high = np.reshape(clip.box, (3, 2)).T
        found &= ((world >= low) & (world <= high)).all(axis=1)
    return found
