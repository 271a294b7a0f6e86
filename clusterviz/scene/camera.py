"""The camera that sees everything: PyVista's isometric view, as near as the picture's narrower angle allows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import SceneError
from clusterviz.scene.checks import PARALLEL, UnusableError, check_camera, difference, sine
from clusterviz.scene.values import Camera

Vector = tuple[float, float, float]
DIRECTIONS: tuple[Vector, ...] = ((1.0, 1.0, 1.0), (1.0, 0.0, 0.0))
"""From the focal point to the eye: the first that is not along view_up."""
UPS: tuple[Vector, ...] = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
"""What is up: the first that is not along the view."""
FARTHEST = 1e150
"""No default eye is farther away, however small the angle of view."""


def fitted_camera(camera: Camera, corners: NDArray[np.float64], spacing: float, size: tuple[int, int]) -> Camera:
    """The camera with position, focal point and view_up; what it has already is kept.

    Parameters
    ----------
    camera : any of its three vectors may be None
    corners : float64 (n, 3), points whose bounding sphere shall be seen
    spacing : world units; the size of a scene whose points all coincide
    size : width and height of the picture, pixels

    Returns
    -------
    camera : never degenerate

    Raises
    ------
    SceneError
        What is given leaves no good choice: an eye whose view_up points along its view of the centre.
    """
    centre, radius = bounding_sphere(corners, spacing)
    given_up = camera.view_up or UPS[0]
    toward_eye = next(direction for direction in DIRECTIONS if sine(direction, given_up) > PARALLEL)
    distance = fitting_distance(radius, camera.view_angle, size)
    position, focal_point = camera.position, camera.focal_point
    if focal_point is None:
        focal_point = centre if position is None else _away(position, centre, toward_eye, radius)
    if position is None:
        position = moved(focal_point, toward_eye, distance + math.dist(focal_point, centre))
    view = difference(focal_point, position)
    view_up = camera.view_up or next(up for up in UPS if sine(up, view) > PARALLEL)
    try:
        check_camera(position, focal_point, view_up)
    except UnusableError as error:
        where = f"camera.{error.key}"
        raise SceneError(error.what, where=where, found=error.found, allowed=error.allowed) from None
    return camera.model_copy(update={"position": position, "focal_point": focal_point, "view_up": view_up})


def bounding_sphere(corners: NDArray[np.float64], spacing: float) -> tuple[Vector, float]:
    """Centre and radius (world) of a sphere around points; its radius is more than 0 and felt at its place."""
    x, y, z = (float(v) for v in (corners / len(corners)).sum(axis=0))
    radius = max(math.dist((x, y, z), corner) for corner in corners.tolist())
    felt = max(abs(v) for v in (x, y, z)) * 2.0**-40
    return (x, y, z), max(radius, spacing, felt)


def fitting_distance(radius: float, view_angle: float, size: tuple[int, int]) -> float:
    """From how far away a sphere just fits the narrower of the two angles of view, world units."""
    vertical = math.radians(view_angle) / 2
    horizontal = math.atan(math.tan(vertical) * size[0] / size[1])
    return max(radius, min(radius / math.sin(min(vertical, horizontal)), FARTHEST))


def moved(point: Vector, direction: Vector, distance: float) -> Vector:
    """The point at a distance in a direction."""
    step = distance / math.hypot(*direction)
    x, y, z = (p + step * d for p, d in zip(point, direction, strict=True))
    return x, y, z


def _away(position: Vector, centre: Vector, toward_eye: Vector, radius: float) -> Vector:
    """The centre as focal point; for an eye that sits there, a point in front of it."""
    return centre if position != centre else moved(position, toward_eye, -radius)
