"""Camera: its keys, and its completion: named views, rotations and fitting become position, focal_point and view_up.

Without a position the eye lies in the direction of `view`, by default (1, 1, 1) as in PyVista, at the smallest distance
from which all visible corners are in the picture. `azimuth`, `elevation` and `roll` rotate as in VTK.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from clusterviz.errors import SceneError
from clusterviz.scene.checks import InvalidValueError, to_builtin
from clusterviz.scene.field_types import FINITE, NotNegative, Number, Positive, Section, Vector

View = Literal[
    "iso", "front", "back", "left", "right", "top", "bottom", "anterior", "posterior", "superior", "inferior"
]
PARALLEL = 1e-6
"""Sine of the angle below which `view_up` counts as parallel to the direction of view."""
Floats = NDArray[np.float64]
DIRECTIONS: tuple[Vector, ...] = ((1.0, 1.0, 1.0), (1.0, 0.0, 0.0))
"""Default directions from the focal point to the eye; the first that is not parallel to view_up is used."""
UPS: tuple[Vector, ...] = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
"""Default view_up vectors; the first that is not parallel to the direction of view is used."""
MAX_DISTANCE = 1e150
"""Largest distance of a fitted eye from the focal point, world units."""
MARGIN = 0.04
"""Margin around a fitted scene, as a share of half the picture's sides."""
MIN_RADII = 1.05
"""Smallest distance of a fitted eye from the centre, in radii of the bounding sphere."""
MAX_VIEW_ANGLE = 150.0
VIEW_ANGLE_INSIDE = 90.0
"""View angles (degrees) chosen for a given position: the largest, and the one used with corners behind the eye."""

OPPOSITE = dict(zip("RLAPSI", "LRPAIS", strict=True))
DEFAULT_ORIENTATION = "RPS"
"""Anatomical direction of x, y and z for data without an orientation: right, back and top, as in CAD."""
EYE_SIDES = {
    **dict.fromkeys(("front", "anterior"), "A"),
    **dict.fromkeys(("back", "posterior"), "P"),
    **dict.fromkeys(("top", "superior"), "S"),
    **dict.fromkeys(("bottom", "inferior"), "I"),
    "left": "L",
    "right": "R",
}
"""Anatomical side of the eye, by the name of the view."""


class Camera(Section):
    """Camera as in VTK, or a named view; unset keys are chosen so that everything visible is in the picture."""

    position: Vector | None = Field(
        default=None,
        description="Position of the eye, world units; default: the nearest in the direction of view that fits.",
    )
    focal_point: Vector | None = Field(
        default=None, description="Point in the centre of the picture, world units; default: the centre of the scene."
    )
    view_up: Vector | None = Field(
        default=None, description="The direction that is up in the picture; need not be a unit."
    )
    view_angle: Annotated[float, FINITE, Field(gt=0, lt=180), BeforeValidator(to_builtin)] = Field(
        default=30.0, description="Vertical angle of view, degrees."
    )
    parallel_scale: Positive | None = Field(
        default=None, description="Half the picture's height in world units: parallel projection; null: perspective."
    )
    window_center: Annotated[tuple[Number, Number], BeforeValidator(to_builtin)] = Field(
        default=(0.0, 0.0),
        examples=[[0.1, 0]],
        description="Centre of the picture to the right of and above the direction of view, in halves of its width and "
        "height, as VTK's WindowCenter: an off-axis frustum.",
    )
    aperture: NotNegative = Field(
        default=0.0,
        examples=[0.5],
        description="Radius of a thin lens, world units: what is not at focal_distance is blurred; 0: a pinhole, all "
        "is sharp. Perspective only.",
    )
    focal_distance: Positive | None = Field(
        default=None,
        description="Distance from the eye, along the direction of view, of the plane that is in focus, world units; "
        "default: that of the focal point.",
    )
    view: View | None = Field(
        default=None,
        description="Side of the eye, instead of position: the side of the body if the file has an orientation (front "
        "is anterior, top superior), else front -y, back +y, left -x, right +x, top +z, bottom -z; iso: right, front "
        "and top of a body, else (1, 1, 1).",
    )
    azimuth: Number = Field(
        default=0.0, description="Rotation of the eye about view_up to its right, degrees; as in VTK."
    )
    elevation: Number = Field(default=0.0, description="Rotation of the eye upwards, degrees; as in VTK.")
    roll: Number = Field(
        default=0.0, description="Clockwise rotation of the camera about the direction of view, degrees; as in VTK."
    )
    zoom: Positive = Field(default=1.0, description="Magnification by a narrower view angle.")
    fit: Annotated[bool, Field(strict=True)] | Literal["orbit"] | None = Field(
        default=None,
        description="true: the eye moves along its direction of view so that everything visible just fits, as without "
        "a position; orbit: so that it fits during an orbit.",
    )

    @model_validator(mode="after")
    def _not_degenerate(self) -> Camera:
        check_camera(self.position, self.focal_point, self.view_up)
        check_view(self.view, self.position)
        check_aperture(self.aperture, self.parallel_scale)
        return self


def check_camera(position: Vector | None, focal_point: Vector | None, view_up: Vector | None) -> None:
    """Refuse degenerate cameras; values that are None are not checked."""
    if view_up is not None and not any(view_up):
        raise InvalidValueError(
            "the zero vector has no direction", "a direction, such as [0, 0, 1]", key="view_up", found=list(view_up)
        )
    if position is None or focal_point is None:
        return
    if position == focal_point:
        raise InvalidValueError(
            "the same as position", "a point other than position", key="focal_point", found=list(position)
        )
    if view_up is not None and sine(difference(focal_point, position), view_up) < PARALLEL:
        raise InvalidValueError(
            "parallel to the direction of view", "any other direction", key="view_up", found=list(view_up)
        )


def check_aperture(aperture: float, parallel_scale: float | None) -> None:
    """Refuse a lens with parallel projection, whose rays meet in no eye."""
    if aperture and parallel_scale is not None:
        text = "not with parallel_scale: a thin lens has perspective"
        raise InvalidValueError(text, "0, or parallel_scale: null", key="aperture", found=aperture)


def check_view(view: str | None, position: Vector | None) -> None:
    """Refuse a named view together with a position."""
    if view is not None and position is not None:
        raise InvalidValueError("position says where the eye is", "one of the two keys", key="view", found=view)


def difference(a: Vector, b: Vector) -> Vector:
    """Return the direction of a − b with a largest component of 1, without under- or overflow.

    Halves are subtracted, since the whole difference may overflow.
    """
    d = [p / 2 - q / 2 for p, q in zip(a, b, strict=True)]
    if not any(d):
        d = [p - q for p, q in zip(a, b, strict=True)]
    return _scaled(d)


def sine(a: Vector, b: Vector) -> float:
    """Return the sine of the angle between two non-zero vectors of any magnitude."""
    (ax, ay, az), (bx, by, bz) = _scaled(a), _scaled(b)
    cross = math.hypot(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    return cross / (math.hypot(ax, ay, az) * math.hypot(bx, by, bz))


def _scaled(vector: Sequence[float]) -> Vector:
    largest = max(abs(v) for v in vector)
    x, y, z = (v / largest for v in vector)
    return x, y, z


def fitted_camera(
    camera: Camera,
    corners: Floats,
    spacing: float,
    size: tuple[int, int],
    orientation: str = "",
    margin: float = MARGIN,
    axes: str = DEFAULT_ORIENTATION,
) -> Camera:
    """Return a camera with position, focal point and view_up; values that are set are kept.

    Returns a non-degenerate camera without named view, rotations, zoom or fit. Raises SceneError: the given values are
    degenerate, such as a view_up along the direction of view.

    Parameters
    ----------
    camera : the camera of a scene file
    corners : float64 (n, 3), points to fit into the picture, world
    spacing : world units; the size of a volume of one sample; 0 without volumes
    size : width and height of the picture, pixels
    orientation : anatomical directions of x, y and z of the world, such as "RAS"; "" if unknown
    margin : around the points, as a share of half the picture's sides
    axes : directions of x, y and z for data without an orientation, such as "RSA" where y is up
    """
    if is_completed(camera):
        return camera
    centre, radius = bounding_sphere(corners, spacing)
    toward_eye, word_up = _named_direction(camera, orientation, axes)
    focal_point, position, angle = camera.focal_point, camera.position, camera.view_angle
    fits = bool(camera.fit) or position is None
    if focal_point is None:
        focal_point = centre if position is None else _default_focal_point(position, centre, toward_eye, radius)
        if not fits and position is not None and "view_angle" not in camera.model_fields_set:
            angle = max(angle, _view_angle_for(position, focal_point, camera.view_up, corners, size))
    if position is None:
        position = point_along(focal_point, toward_eye, radius)
    position, view_up = _apply_rotations(camera, position, focal_point, camera.view_up or word_up)
    found: dict[str, Any] = {}
    if fits:
        points = _sphere(centre, radius) if camera.fit == "orbit" else corners
        ahead, aside = _view_coordinates(focal_point, focal_point, position, view_up, points)
        needed = np.abs(aside) / (1 - margin) / (size[0] / size[1], 1.0)
        nearest = math.dist(focal_point, centre) + MIN_RADII * radius
        tangent = math.tan(math.radians(angle) / 2)
        distance = max(nearest, min(float((needed.max(axis=1) / tangent - ahead).max()), MAX_DISTANCE))
        position = point_along(focal_point, difference(position, focal_point), distance)
        if camera.parallel_scale is not None and camera.fit:
            found["parallel_scale"] = float(needed.max()) or radius
    if camera.zoom != 1.0 and camera.parallel_scale is not None:
        found["parallel_scale"] = found.get("parallel_scale", camera.parallel_scale) / camera.zoom
    elif camera.zoom != 1.0:
        angle = math.degrees(2 * math.atan(math.tan(math.radians(angle) / 2) / camera.zoom))
    try:
        check_camera(position, focal_point, view_up)
    except InvalidValueError as error:
        where = f"camera.{error.key}"
        raise SceneError(error.what, where=where, found=error.found, allowed=error.allowed) from None
    words = {name: Camera.model_fields[name].default for name in WORDS}
    given = {"position": position, "focal_point": focal_point, "view_up": view_up, "view_angle": angle}
    return camera.model_copy(update={**words, **given, **found})


WORDS = ("view", "azimuth", "elevation", "roll", "zoom", "fit")
"""Keys that have their defaults in a completed camera."""


def camera_vectors(camera: Camera) -> tuple[Vector, Vector, Vector]:
    """Return position, focal point and view_up of a completed camera.

    Raises ValueError: the camera is not completed.
    """
    if camera.position is None or camera.focal_point is None or camera.view_up is None:
        raise ValueError("a view needs a completed camera; call complete_scene first")
    return camera.position, camera.focal_point, camera.view_up


def camera_axes(position: Vector, focal_point: Vector, view_up: Vector) -> tuple[Floats, Floats, Floats]:
    """Return unit vectors, float64 (3,), to the right, up and forward of a camera, world."""
    forward = _unit(np.array(difference(focal_point, position)))
    right = _unit(np.cross(forward, _unit(np.array(view_up, float))))
    return right, np.cross(right, forward), forward


def project_points(camera: Camera, points: Floats, size: tuple[int, int]) -> tuple[Floats, Floats]:
    """Project points to pixels of a completed camera.

    `points`: float64 (n, 3), world; `size`: width and height of the picture, pixels.

    Returns
    -------
    pixels : float64 (n, 2), x and y from the top left corner; undefined where `ahead` is not positive
    ahead : float64 (n,), depth along the direction of view, world units
    """
    ahead, aside = camera_coordinates(camera, points)
    half = half_height(camera, np.where(ahead > 0, ahead, np.inf))[:, None]
    centre = np.array(size) / 2 * (1 + np.array(camera.window_center) * (-1, 1))
    return centre + aside * (1, -1) / half * size[1] / 2, ahead


def camera_coordinates(camera: Camera, points: Floats) -> tuple[Floats, Floats]:
    """Return depths (n,) and right and up coordinates (n, 2) of points from a completed camera's eye, world units."""
    position, focal_point, view_up = camera_vectors(camera)
    return _view_coordinates(position, focal_point, position, view_up, points)


def half_height(camera: Camera, ahead: Floats) -> Floats:
    """Return half the picture's height in world units at depths ahead of the eye."""
    if camera.parallel_scale is not None:
        return np.full_like(ahead, camera.parallel_scale)
    return ahead * math.tan(math.radians(camera.view_angle) / 2)


def bounding_sphere(corners: Floats, spacing: float) -> tuple[Vector, float]:
    """Return centre and radius (world) of a sphere around points.

    The radius is at least `spacing`, and large enough to change coordinates of the centre's magnitude; 1 of nothing.
    """
    x, y, z = (float(v) for v in corners.min(axis=0) / 2 + corners.max(axis=0) / 2)
    radius = float(np.linalg.norm((corners - (x, y, z)), axis=1).max())
    resolvable = max(abs(v) for v in (x, y, z)) * 2.0**-40
    return (x, y, z), max(radius, spacing, resolvable) or 1.0


def point_along(point: Vector, direction: Vector, distance: float) -> Vector:
    """Return the point at a distance from another in a direction."""
    step = distance / math.hypot(*direction)
    return _to_tuple(p + step * d for p, d in zip(point, direction, strict=True))


def is_completed(camera: Camera) -> bool:
    """Return whether position, focal_point and view_up are set, and all of `WORDS` have their defaults."""
    words = any(getattr(camera, name) != Camera.model_fields[name].default for name in WORDS)
    return None not in (camera.position, camera.focal_point, camera.view_up) and not words


def _named_direction(camera: Camera, orientation: str, axes: str) -> tuple[Vector, Vector | None]:
    letters = orientation or axes

    def axis(letter: str) -> Floats:
        index = next(i for i, found in enumerate(letters) if found in (letter, OPPOSITE[letter]))
        vector: Floats = np.eye(3)[index] * (1.0 if letters[index] == letter else -1.0)
        return vector

    if camera.view in (None, "iso"):
        default = np.abs(axis("R")) + (axis("A") if orientation else np.abs(axis("P"))) + axis("S")
        up = camera.view_up or _to_tuple(axis("S"))
        choices = (_to_tuple(default), *DIRECTIONS)
        return next(each for each in choices if sine(each, up) > PARALLEL), up
    side = EYE_SIDES[camera.view]
    up = _to_tuple(axis(("A" if orientation else "P") if side in "SI" else "S"))
    return _to_tuple(axis(side)), up


def _apply_rotations(camera: Camera, position: Vector, focal_point: Vector, up: Vector | None) -> tuple[Vector, Vector]:
    """Return position and view_up after azimuth, elevation and roll; view_up is kept where it is still valid."""
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
    if lifted_up @ kept <= 0 or sine(_to_tuple(kept), _to_tuple(lifted)) < 1e-3:
        kept = lifted_up
    if camera.azimuth or camera.elevation:
        position = point_along(focal_point, _to_tuple(lifted), distance)
    return position, _to_tuple(_rotated(kept, -lifted, camera.roll)) if camera.roll else _to_tuple(kept)


def _rotated(vector: Floats, axis: Floats, degrees: float) -> Floats:
    angle = math.radians(degrees)
    turned: Floats = vector * math.cos(angle) + np.cross(axis, vector) * math.sin(angle)
    return turned + axis * (axis @ vector) * (1 - math.cos(angle))


def _view_coordinates(
    origin: Vector, focal_point: Vector, position: Vector, view_up: Vector, points: Floats
) -> tuple[Floats, Floats]:
    """Return depths (n,) and right and up coordinates (n, 2) of points relative to an origin, world units."""
    if sine(view_up, difference(focal_point, position)) <= PARALLEL:  # refused by check_camera
        view_up = next(each for each in UPS if sine(each, difference(focal_point, position)) > PARALLEL)
    right, up, forward = camera_axes(position, focal_point, view_up)
    offsets = points - np.array(origin)
    return offsets @ forward, np.stack([offsets @ right, offsets @ up], axis=1)


def _view_angle_for(
    position: Vector, focal_point: Vector, view_up: Vector | None, corners: Floats, size: tuple[int, int]
) -> float:
    _, up = _apply_rotations(Camera(), position, focal_point, view_up)
    ahead, aside = _view_coordinates(position, focal_point, position, up, corners)
    if (ahead <= 0).any():
        return VIEW_ANGLE_INSIDE
    needed = np.abs(aside) / ahead[:, None] / (1 - MARGIN) / (size[0] / size[1], 1.0)
    return min(math.degrees(2 * math.atan(float(needed.max()))), MAX_VIEW_ANGLE)


def _sphere(centre: Vector, radius: float) -> Floats:
    """Return points on a sphere, float64 (1200, 3), dense enough for the picture's margin."""
    steps = np.linspace(0, 2 * math.pi, 48, endpoint=False)
    heights = np.linspace(-1, 1, 25)
    around = np.stack(np.meshgrid(steps, heights), axis=-1).reshape(-1, 2)
    ring = np.sqrt(1 - around[:, 1] ** 2)
    unit = np.stack([ring * np.cos(around[:, 0]), ring * np.sin(around[:, 0]), around[:, 1]], axis=1)
    return np.array(centre) + radius * unit


def _default_focal_point(position: Vector, centre: Vector, toward_eye: Vector, radius: float) -> Vector:
    """Return the centre, or a point in front of the eye if the eye is at the centre."""
    return centre if position != centre else point_along(position, toward_eye, -radius)


def _unit(vector: Floats) -> Floats:
    # Scaled first: the squares of 1e-200 or 1e200 would leave float64.
    scaled = vector / np.abs(vector).max()
    unit: Floats = scaled / np.linalg.norm(scaled)
    return unit


def _to_tuple(values: Any) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z
