"""The checks of single scene values that a type cannot express, each with what was found and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, TypeVar

Points = TypeVar("Points", bound=tuple[tuple[float, ...], ...])
Vector = tuple[float, float, float]
Bounds = tuple[float, float, float, float, float, float]

ORTHONORMAL = 1e-3
"""How far products of the axes of a direction may be from 0 and 1: numbers written with four digits will do."""

PARALLEL = 1e-6
"""Sine of the angle below which `view_up` counts as parallel to the direction of view."""


class UnusableError(ValueError):
    """A value that the scene cannot have; pydantic carries it to `scene.complaints`.

    Parameters
    ----------
    what : what is wrong
    allowed : what may be there
    key : the key inside the checked section, where the check is of a whole section
    found : what was there, where it is not the checked value itself
    """

    def __init__(self, what: str, allowed: str, *, key: str = "", found: object = None) -> None:
        super().__init__(f"{what}; allowed {allowed}")
        self.what, self.allowed, self.key, self.found = what, allowed, key, found


def plain(value: Any) -> Any:
    """NumPy scalars and arrays as Python numbers and lists; everything else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value


def form_of(value: Any) -> str:
    """Which type of a value is meant, by its form: the tag of one branch of a union in `scene.values`."""
    if isinstance(value, str):
        return "<name>"
    return "<points>" if _is_sequence(value) else "<number>"


def form_of_map(value: Any) -> str:
    """The same for a colour map, whose colours may come without values."""
    form = form_of(value)
    if form == "<points>" and value and all(_is_sequence(row) and len(row) == 3 for row in value):
        return "<colours>"
    return form


def check_path(value: str) -> str:
    """A path: neither empty nor with a NUL, which no file system takes."""
    if not value.strip() or "\0" in value:
        raise UnusableError("not a path", "the path of a data file")
    return value


def check_channel(value: Any) -> Any:
    """A number from 0 on, or a name."""
    value = plain(value)
    if value is None or (type(value) is int and value >= 0) or (isinstance(value, str) and value.strip()):
        return value
    raise UnusableError("not a channel", "a whole number from 0 on, or a name that the file gives to a channel")


def check_direction(value: tuple[Vector, Vector, Vector]) -> tuple[Vector, Vector, Vector]:
    """Three axes of length 1 at right angles, as columns; a left-handed set is one too."""
    columns = list(zip(*value, strict=True))
    for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        product = sum(p * q for p, q in zip(columns[a], columns[b], strict=True))
        if not abs(product - (a == b)) <= ORTHONORMAL:
            allowed = (
                "3 rows of 3 numbers whose columns are unit vectors at right angles: the axes x, y, z in the world"
            )
            raise UnusableError("not orthonormal", allowed)
    return value


def check_clim(value: tuple[float, float]) -> tuple[float, float]:
    """The ends of the colour map in order; equal ends are a step."""
    if value[0] > value[1]:
        raise UnusableError("the low end lies above the high end", "[low, high] with low <= high")
    return value


def check_points(points: Points) -> Points:
    """Control points: at least one, sorted by value; a value that occurs twice is a step."""
    if not points:
        raise UnusableError("no control points", "at least one")
    return check_order(points)


def check_order(points: Points) -> Points:
    """Control points, if any, sorted by value."""
    for before, after in pairwise(points):
        if after[0] < before[0]:
            raise UnusableError(f"control points out of order: {after[0]} after {before[0]}", "points sorted by value")
    return points


def check_cmap(value: Any) -> Any:
    """A name, a file, colours or points, checked by their own types; matplotlib's colour maps become such."""
    value = plain(value)
    if callable(value) and (hasattr(value, "color_stops") or hasattr(value, "N")):
        from clusterviz.scene.colormaps import colours_of

        return colours_of(value)
    if value is None or _is_sequence(value) or (isinstance(value, str) and value.strip()):
        return value
    allowed = (
        "a name that `clusterviz cmaps` lists, [[value, r, g, b], …], [[r, g, b], …], or a ParaView preset (.json)"
    )
    raise UnusableError("not a colour map", allowed)


def check_opacity(value: Any) -> Any:
    """A number, a preset's name or points."""
    from clusterviz.scene.opacity import PRESET_NAMES, PRESETS

    value = plain(value)
    if isinstance(value, str) and value not in PRESETS:
        raise UnusableError("unknown opacity preset", f"a number, [[value, opacity], …], or one of {PRESET_NAMES}")
    if isinstance(value, bool) or not (value is None or isinstance(value, (str, int, float)) or _is_sequence(value)):
        raise UnusableError("not an opacity", "a number in 0..1, [[value, opacity], …], or a preset such as linear")
    return value


def check_surface(value: Any) -> Any:
    """A number or a list; what they hold is checked by their own types."""
    value = plain(value)
    if isinstance(value, bool) or not (isinstance(value, (int, float)) or _is_sequence(value)):
        raise UnusableError("not a surface", "a data value, or [value, opacity]")
    return value


def check_surfaces(blending: str, isosurfaces: tuple[object, ...]) -> None:
    """A picture of isosurfaces needs some, and a projection shows none."""
    if blending == "isosurface" and not isosurfaces:
        raise UnusableError("missing", "one data value or more, for blending: isosurface", key="isosurfaces")
    if isosurfaces and blending not in ("composite", "isosurface"):
        allowed = "this key with blending: composite or isosurface"
        raise UnusableError(f"not for blending: {blending}", allowed, key="isosurfaces")


def check_gradient(kernel: str, interpolation: str) -> None:
    """Nearest voxels are no field that a spline could follow."""
    if kernel == "smooth" and interpolation == "nearest":
        raise UnusableError("not for interpolation: nearest", "central", key="gradient", found=kernel)


def check_grading(blending: str, fades: bool, has_table: bool, has_opacity: bool) -> None:
    """What depends on the gradient belongs to composited volumes, and says opacity only once."""
    for key, found in (("gradient_opacity", fades), ("transfer_2d", has_table)):
        if found and blending != "composite":
            raise UnusableError(f"not for blending: {blending}", "this key with blending: composite", key=key)
    if has_table and (has_opacity or fades):
        other = "opacity" if has_opacity else "gradient_opacity"
        raise UnusableError("opacity is in transfer_2d already", "one of the two keys", key=other)


def check_light(kind: str, position: Vector | None, focal_point: Vector, everywhere: bool) -> None:
    """A light that stays where it is needs a position, and a direction unless it shines everywhere."""
    if kind == "headlight":
        return
    if position is None:
        raise UnusableError("missing", "where the light shines from, [x, y, z]", key="position")
    if position == focal_point and not everywhere:
        raise UnusableError(
            "the same as focal_point", "a point other than focal_point", key="position", found=list(position)
        )


def check_attenuation(kind: str, positional: bool, attenuation: Vector) -> None:
    """A headlight is far away, and what divides the light of a positional one is not nothing."""
    if positional and kind == "headlight":
        raise UnusableError("a headlight shines from afar", "type: scene, or positional: false", key="positional")
    if not any(attenuation):
        raise UnusableError("divides by nothing", "one number above 0", key="attenuation", found=list(attenuation))


def check_normal(value: Vector) -> Vector:
    """A direction."""
    if not any(value):
        raise UnusableError("the zero vector has no direction", "a direction, such as [0, 0, 1]")
    return value


def check_box(value: Bounds) -> Bounds:
    """Bounds in order along each axis."""
    for axis, name in enumerate("xyz"):
        if value[2 * axis] > value[2 * axis + 1]:
            raise UnusableError(f"{name}min lies above {name}max", "[xmin, xmax, ymin, ymax, zmin, zmax]")
    return value


def check_camera(position: Vector | None, focal_point: Vector | None, view_up: Vector | None) -> None:
    """A view needs a direction, and an up that is not along it; what is None is not checked."""
    if view_up is not None and not any(view_up):
        raise UnusableError(
            "the zero vector has no direction", "a direction, such as [0, 0, 1]", key="view_up", found=list(view_up)
        )
    if position is None or focal_point is None:
        return
    if position == focal_point:
        raise UnusableError(
            "the same as position", "a point other than position", key="focal_point", found=list(position)
        )
    if view_up is not None and sine(difference(focal_point, position), view_up) < PARALLEL:
        raise UnusableError(
            "parallel to the direction of view", "any other direction", key="view_up", found=list(view_up)
        )


def check_view(view: str | None, position: Vector | None) -> None:
    """A word for where the eye stands, or its position."""
    if view is not None and position is not None:
        raise UnusableError("position says where the eye is", "one of the two keys", key="view", found=view)


def difference(a: Vector, b: Vector) -> Vector:
    """The direction of a − b, scaled to a largest component of 1 so that no length under- or overflows.

    The difference is taken of halves where the whole would overflow, which changes no direction.
    """
    d = [p / 2 - q / 2 for p, q in zip(a, b, strict=True)]
    if not any(d):
        d = [p - q for p, q in zip(a, b, strict=True)]
    return _scaled(d)


def sine(a: Vector, b: Vector) -> float:
    """Sine of the angle between two non-zero vectors of any magnitude."""
    (ax, ay, az), (bx, by, bz) = _scaled(a), _scaled(b)
    cross = math.hypot(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    return cross / (math.hypot(ax, ay, az) * math.hypot(bx, by, bz))


def _scaled(vector: Sequence[float]) -> Vector:
    largest = max(abs(v) for v in vector)
    x, y, z = (v / largest for v in vector)
    return x, y, z


def _is_sequence(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))
