"""Thin lens of a camera: eye points on it, and circles of confusion.

A point at depth z is seen sharp from all of the lens if z is the focal distance F. Otherwise its image is a disc, the
circle of confusion. Seen from the point p of the lens, of radius 1, it lies p · r(z) beside where the pinhole sees it,

    r(z) = aperture · (1 / F − 1 / z)

on the plane one world unit in front of the eye: negative in front of the plane in focus, positive behind it, where r
is at most aperture / F.

Reference: P. Haeberli, K. Akeley: The accumulation buffer: hardware support for high-quality rendering, SIGGRAPH 1990,
4. P. Shirley, K. Chiu: A low distortion map between disk and square, Journal of Graphics Tools 2(3), 1997.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.scene.camera import camera_axes, camera_vectors
from clusterviz.scene.values import Camera, Scene

Floats = NDArray[np.float64]


def focal_distance(camera: Camera) -> float:
    """Return the distance of the plane in focus of a completed camera, world units."""
    position, focal_point, _ = camera_vectors(camera)
    return camera.focal_distance if camera.focal_distance is not None else math.dist(position, focal_point)


def has_eye_points(scene: Scene) -> bool:
    """Return whether a scene has a lens whose eye points are drawn one by one."""
    return scene.camera.aperture > 0 and scene.quality.lens.eye_points is not None


def lens_points(count: int) -> Floats:
    """Return points on a disc of radius 1, float64 (count, 2), whose mean is that of the disc in the limit.

    Hammersley's points of a square, which have a low discrepancy, by the concentric map, which keeps areas. A single
    one is the centre.
    """
    number = np.arange(count)
    mirrored = sum((number >> bit & 1) / 2.0 ** (bit + 1) for bit in range(max(1, count).bit_length()))
    a, b = 2 * (number + 0.5) / count - 1, 2 * (mirrored + 0.5 / 2 ** max(0, count - 1).bit_length()) - 1
    radius = np.where(np.abs(a) > np.abs(b), a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.where(np.abs(a) > np.abs(b), math.pi / 4 * b / a, math.pi / 2 - math.pi / 4 * a / b)
    angle = np.where(radius == 0, 0.0, angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def eye_points(scene: Scene, count: int) -> list[Scene]:
    """Return a completed scene seen by pinholes on its lens, with frusta that meet on the plane in focus.

    The mean of their pictures is the picture of the lens; its error falls with the number of eye points.
    """
    camera, (width, height) = scene.camera, scene.image.size
    position, focal_point, view_up = camera_vectors(camera)
    right, up, _ = camera_axes(position, focal_point, view_up)
    halves = focal_distance(camera) * math.tan(math.radians(camera.view_angle) / 2) * np.array([width / height, 1.0])
    found = []
    for offset in camera.aperture * lens_points(count):
        moved = offset @ np.array([right, up])
        update: dict[str, Any] = {
            name: tuple((np.array(point) + moved).tolist())
            for name, point in (("position", position), ("focal_point", focal_point))
        }
        update["window_center"] = tuple((np.array(camera.window_center) - offset / halves).tolist())
        update["aperture"] = 0.0
        found.append(scene.model_copy(update={"camera": camera.model_copy(update=update)}))
    return found
