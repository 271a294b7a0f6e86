"""Cameras by words and by what they shall see: a completed camera has position, focal_point and view_up.

Without a position the eye stands in the direction that `view` names, (1, 1, 1) by default as in PyVista, as near as
all corners of what is shown stay in the picture. `azimuth`, `elevation` and `roll` turn as VTK's do.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import SceneError
from clusterviz.scene.checks import PARALLEL, UnusableError, check_camera, difference, sine
from clusterviz.scene.values import Camera

Vector = tuple[float, float, float]
Floats = NDArray[np.float64]
DIRECTIONS: tuple[Vector, ...] = ((1.0, 1.0, 1.0), (1.0, 0.0, 0.0))
"""From the focal point to the eye: the first that is not along view_up."""
UPS: tuple[Vector, ...] = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
"""What is up: the first that is not along the view."""
FARTHEST = 1e150
"""No default eye is farther away, however small the angle of view."""
MARGIN = 0.04
"""Share of the picture's half sides that stays free around what is fitted."""
NEAREST = 1.05
"""No fitted eye is nearer to the centre, in radii of the bounding sphere."""
WIDEST = 150.0
INSIDE = 90.0
"""Angles of view (degrees) for a lone position: the widest that is chosen, and that with corners behind the eye."""

OPPOSITE = dict(zip("RLAPSI", "LRPAIS", strict=True))
UNKNOWN = "RPS"
"""What x, y and z point to where the data does not say: right, back and top, as in CAD."""
STANDS = {
    **dict.fromkeys(("front", "anterior"), "A"),
    **dict.fromkeys(("back", "posterior"), "P"),
    **dict.fromkeys(("top", "superior"), "S"),
    **dict.fromkeys(("bottom", "inferior"), "I"),
    "left": "L",
    "right": "R",
}
"""Side of the body on which the eye stands, by the word for the view."""


def fitted_camera(
    camera: Camera, corners: Floats, spacing: float, size: tuple[int, int], orientation: str = ""
) -> Camera:
    """The camera with position, focal point and view_up; what it has already is kept.

    Parameters
    ----------
    camera : as written
    corners : float64 (n, 3), points that shall be seen, in the world
    spacing : world units; the size of a scene whose points all coincide
    size : width and height of the picture, pixels
    orientation : what x, y and z of the world point to, as in "RAS"; "" where that is not known

    Returns
    -------
    camera : never degenerate; no word is left in it

    Raises
    ------
    SceneError
        What is given leaves no good choice: an eye whose view_up points along its view of the centre.
    """
    if is_completed(camera):
        return camera
    centre, radius = bounding_sphere(corners, spacing)
    toward_eye, word_up = _named(camera, orientation)
    focal_point, position, angle = camera.focal_point, camera.position, camera.view_angle
    fits = bool(camera.fit) or position is None
    if focal_point is None:
        focal_point = centre if position is None else _away(position, centre, toward_eye, radius)
        if not fits and position is not None and "view_angle" not in camera.model_fields_set:
            angle = max(angle, _angle_for(position, focal_point, camera.view_up, corners, size))
    if position is None:
        position = moved(focal_point, toward_eye, radius)
    position, view_up = _turned(camera, position, focal_point, camera.view_up or word_up)
    found: dict[str, Any] = {}
    if fits:
        points = _sphere(centre, radius) if camera.fit == "orbit" else corners
        ahead, aside = _from(focal_point, focal_point, position, view_up, points)
        needed = np.abs(aside) / (1 - MARGIN) / (size[0] / size[1], 1.0)
        nearest = math.dist(focal_point, centre) + NEAREST * radius
        tangent = math.tan(math.radians(angle) / 2)
        distance = max(nearest, min(float((needed.max(axis=1) / tangent - ahead).max()), FARTHEST))
        position = moved(focal_point, difference(position, focal_point), distance)
        if camera.parallel_scale is not None and camera.fit:
            found["parallel_scale"] = float(needed.max()) or radius
    if camera.zoom != 1.0 and camera.parallel_scale is not None:
        found["parallel_scale"] = found.get("parallel_scale", camera.parallel_scale) / camera.zoom
    elif camera.zoom != 1.0:
        angle = math.degrees(2 * math.atan(math.tan(math.radians(angle) / 2) / camera.zoom))
    try:
        check_camera(position, focal_point, view_up)
    except UnusableError as error:
        where = f"camera.{error.key}"
        raise SceneError(error.what, where=where, found=error.found, allowed=error.allowed) from None
    words = {name: Camera.model_fields[name].default for name in WORDS}
    given = {"position": position, "focal_point": focal_point, "view_up": view_up, "view_angle": angle}
    return camera.model_copy(update={**words, **given, **found})


WORDS = ("view", "azimuth", "elevation", "roll", "zoom", "fit")
"""Keys that a completed camera has at their defaults."""


def vectors_of(camera: Camera) -> tuple[Vector, Vector, Vector]:
    """Position, focal point and view_up of a completed camera.

    Raises
    ------
    ValueError
        It is not completed.
    """
    if camera.position is None or camera.focal_point is None or camera.view_up is None:
        raise ValueError("a view needs a completed camera; call complete_scene first")
    return camera.position, camera.focal_point, camera.view_up


def camera_axes(position: Vector, focal_point: Vector, view_up: Vector) -> tuple[Floats, Floats, Floats]:
    """Unit vectors (3,) to the right, up and forward of a camera, in the world."""
    forward = _unit(np.array(difference(focal_point, position)))
    right = _unit(np.cross(forward, _unit(np.array(view_up, float))))
    return right, np.cross(right, forward), forward


def pixels_of(camera: Camera, points: Floats, size: tuple[int, int]) -> tuple[Floats, Floats]:
    """Where points of the world are in the picture of a completed camera.

    Parameters
    ----------
    points : float64 (n, 3)

    Returns
    -------
    pixels : float64 (n, 2), x and y from the top left corner; of no meaning for points that are not ahead
    ahead : float64 (n,), distance along the view, world units
    """
    position, focal_point, view_up = vectors_of(camera)
    ahead, aside = _from(position, focal_point, position, view_up, points)
    if camera.parallel_scale is not None:
        half: Any = camera.parallel_scale
    else:
        half = np.where(ahead > 0, ahead, np.inf)[:, None] * math.tan(math.radians(camera.view_angle) / 2)
    return np.array(size) / 2 + aside * (1, -1) / half * size[1] / 2, ahead


def bounding_sphere(corners: Floats, spacing: float) -> tuple[Vector, float]:
    """Centre and radius (world) of a sphere around points; its radius is more than 0 and felt at its place."""
    x, y, z = (float(v) for v in corners.min(axis=0) / 2 + corners.max(axis=0) / 2)
    radius = float(np.linalg.norm((corners - (x, y, z)), axis=1).max())
    felt = max(abs(v) for v in (x, y, z)) * 2.0**-40
    return (x, y, z), max(radius, spacing, felt)


def moved(point: Vector, direction: Vector, distance: float) -> Vector:
    """The point at a distance in a direction."""
    step = distance / math.hypot(*direction)
    return _triple(p + step * d for p, d in zip(point, direction, strict=True))


def is_completed(camera: Camera) -> bool:
    """Whether position, focal_point and view_up are there, and no words."""
    words = any(getattr(camera, name) != Camera.model_fields[name].default for name in WORDS)
    return None not in (camera.position, camera.focal_point, camera.view_up) and not words


def _named(camera: Camera, orientation: str) -> tuple[Vector, Vector | None]:
    """The direction to the eye that `view` names, and its up; of the default view None."""
    letters = orientation or UNKNOWN

    def axis(letter: str) -> Floats:
        index = next(i for i, found in enumerate(letters) if found in (letter, OPPOSITE[letter]))
        vector: Floats = np.eye(3)[index] * (1.0 if letters[index] == letter else -1.0)
        return vector

    if camera.view in (None, "iso"):
        default = np.abs(axis("R")) + axis("A" if orientation else "P") + axis("S")
        up = camera.view_up or (_triple(axis("S")) if camera.view or orientation else UPS[0])
        choices = (_triple(default), *DIRECTIONS)
        return next(each for each in choices if sine(each, up) > PARALLEL), up
    side = STANDS[camera.view]
    up = _triple(axis(("A" if orientation else "P") if side in "SI" else "S"))
    return _triple(axis(side)), up


def _turned(camera: Camera, position: Vector, focal_point: Vector, up: Vector | None) -> tuple[Vector, Vector]:
    """Position and view_up after azimuth, elevation and roll; view_up stays what it is where it still can."""
    view = difference(focal_point, position)
    if up is None or (camera.view_up is None and sine(up, view) <= PARALLEL):
        up = next(each for each in UPS if sine(each, view) > PARALLEL)
    if not (camera.azimuth or camera.elevation or camera.roll) or sine(up, view) <= PARALLEL:
        return position, up
    distance = math.dist(position, focal_point)
    back = _rotated(-_unit(np.array(view)), _unit(np.array(up)), camera.azimuth)
    right = _unit(np.cross(_unit(np.array(up)), back))
    lifted = _rotated(back, -right, camera.elevation)
    lifted_up = np.cross(lifted, right)
    kept = np.array(up)
    if lifted_up @ kept <= 0 or sine(_triple(kept), _triple(lifted)) < 1e-3:
        kept = lifted_up
    if camera.azimuth or camera.elevation:
        position = moved(focal_point, _triple(lifted), distance)
    return position, _triple(_rotated(kept, -lifted, camera.roll)) if camera.roll else _triple(kept)


def _rotated(vector: Floats, axis: Floats, degrees: float) -> Floats:
    """A vector turned about a unit axis, by Rodrigues' formula."""
    angle = math.radians(degrees)
    turned: Floats = vector * math.cos(angle) + np.cross(axis, vector) * math.sin(angle)
    return turned + axis * (axis @ vector) * (1 - math.cos(angle))


def _from(
    origin: Vector, focal_point: Vector, position: Vector, view_up: Vector, points: Floats
) -> tuple[Floats, Floats]:
    """Of points, how far ahead of the origin they are (n,), and how far to its right and up (n, 2), world units."""
    if sine(view_up, difference(focal_point, position)) <= PARALLEL:  # refused by check_camera
        view_up = next(each for each in UPS if sine(each, difference(focal_point, position)) > PARALLEL)
    right, up, forward = camera_axes(position, focal_point, view_up)
    offsets = points - np.array(origin)
    return offsets @ forward, np.stack([offsets @ right, offsets @ up], axis=1)


def _angle_for(
    position: Vector, focal_point: Vector, view_up: Vector | None, corners: Floats, size: tuple[int, int]
) -> float:
    """The vertical angle of view, degrees, at which all corners are seen from a position."""
    _, up = _turned(Camera(), position, focal_point, view_up)
    ahead, aside = _from(position, focal_point, position, up, corners)
    if (ahead <= 0).any():
        return INSIDE
    needed = np.abs(aside) / ahead[:, None] / (1 - MARGIN) / (size[0] / size[1], 1.0)
    return min(math.degrees(2 * math.atan(float(needed.max()))), WIDEST)


def _sphere(centre: Vector, radius: float) -> Floats:
    """Points on a sphere, close enough to it for a picture's margin."""
    steps = np.linspace(0, 2 * math.pi, 48, endpoint=False)
    heights = np.linspace(-1, 1, 25)
    around = np.stack(np.meshgrid(steps, heights), axis=-1).reshape(-1, 2)
    ring = np.sqrt(1 - around[:, 1] ** 2)
    unit = np.stack([ring * np.cos(around[:, 0]), ring * np.sin(around[:, 0]), around[:, 1]], axis=1)
    return np.array(centre) + radius * unit


def _away(position: Vector, centre: Vector, toward_eye: Vector, radius: float) -> Vector:
    """The centre as focal point; for an eye that sits there, a point in front of it."""
    return centre if position != centre else moved(position, toward_eye, -radius)


def _unit(vector: Floats) -> Floats:
    # Scaled first: the squares of 1e-200 or 1e200 would leave float64.
    scaled = vector / np.abs(vector).max()
    unit: Floats = scaled / np.linalg.norm(scaled)
    return unit


def _triple(values: Any) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z
