"""Validators of single scene keys and sections, beyond what their types express.

Each raises an `InvalidValueError` with what was found and what is allowed.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise
from typing import Any, TypeVar

from clusterviz.scene.colormaps import scene_cmap
from clusterviz.scene.transfer import PRESET_NAMES, PRESETS

Points = TypeVar("Points", bound=tuple[tuple[float, ...], ...])
Vector = tuple[float, float, float]
Bounds = tuple[float, float, float, float, float, float]

ORTHONORMAL = 1e-3
"""Tolerance of the dot products of a direction's axes; numbers with four digits pass."""


class InvalidValueError(ValueError):
    """Invalid value of a scene key; `scene.validation_messages` turns it into a `SceneError`.

    `what`: the problem; `allowed`: the values allowed; `key`: the key inside the checked section, for checks of whole
    sections; `found`: the value found, if it is not the checked value itself.
    """

    def __init__(self, what: str, allowed: str, *, key: str = "", found: object = None) -> None:
        super().__init__(f"{what}; allowed {allowed}")
        self.what, self.allowed, self.key, self.found = what, allowed, key, found


def to_builtin(value: Any) -> Any:
    """Return NumPy scalars and arrays as Python numbers and lists, and other values unchanged."""
    return value.tolist() if hasattr(value, "tolist") else value


def union_tag(value: Any) -> str:
    """Return the tag of the union member that a value's form selects."""
    if isinstance(value, str):
        return "<name>"
    return "<points>" if _is_sequence(value) else "<number>"


def cmap_tag(value: Any) -> str:
    """Return the tag of the union member for a colour map, which may be a list of colours without values."""
    form = union_tag(value)
    if form == "<points>" and value and all(_is_sequence(row) and len(row) == 3 for row in value):
        return "<colours>"
    return form


def to_tuple(value: Any) -> Any:
    """Return a single number as a tuple of one."""
    value = to_builtin(value)
    return value if isinstance(value, (list, tuple)) else (value,)


def check_detail(value: Any) -> Any:
    """Refuse what is neither a name nor a mapping."""
    if value == "full" or hasattr(value, "keys") or hasattr(value, "model_fields_set"):
        return value
    raise InvalidValueError("not a detail", "full, {level: n}, {error: e}, {memory: 512 MiB} or {seconds: s}")


UNITS = {"": 1, "B": 1, "KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30, "TiB": 1 << 40, "kB": 10**3, "MB": 10**6,
         "GB": 10**9, "TB": 10**12}  # fmt: skip


def check_size(value: Any) -> Any:
    """Return a number of bytes; "512 MiB" stands for one."""
    value = to_builtin(value)
    if not isinstance(value, str):
        return value
    found = re.fullmatch(r"(\d+(?:\.\d*)?)\s*([a-zA-Z]*)", value.strip())
    if not found or found[2] not in UNITS:
        raise InvalidValueError("not a size", "bytes, or a number and KiB, MiB, GiB, TiB, kB, MB, GB or TB")
    return int(float(found[1]) * UNITS[found[2]])


def check_one_key(keys: Collection[str], known: Iterable[str]) -> None:
    """Refuse a section with no key or several of those that exclude each other."""
    if len(keys) != 1:
        *first, last = known
        raise InvalidValueError(f"not one of {', '.join(first)} and {last}", "one key")


def check_time(value: Any) -> Any:
    """Refuse what is neither the number of a time step nor all of them."""
    value = to_builtin(value)
    if value == "all" or (type(value) is int and value >= 0):
        return value
    raise InvalidValueError("not a time step", "its number, a whole number from 0 on, or all")


def check_path(value: str) -> str:
    """Refuse paths that are empty or contain NUL."""
    if not value.strip() or "\0" in value:
        raise InvalidValueError("not a path", "the path of a data file")
    return value


def check_channel(value: Any) -> Any:
    """Validate a channel: a whole number from 0, or a name."""
    value = to_builtin(value)
    if value is None or (type(value) is int and value >= 0) or (isinstance(value, str) and value.strip()):
        return value
    raise InvalidValueError("not a channel", "a whole number from 0 on, or a name that the file gives to a channel")


def check_direction(value: tuple[Vector, Vector, Vector]) -> tuple[Vector, Vector, Vector]:
    """Validate a direction matrix: orthonormal columns; left-handed axes are allowed."""
    columns = list(zip(*value, strict=True))
    for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        product = sum(p * q for p, q in zip(columns[a], columns[b], strict=True))
        if not abs(product - (a == b)) <= ORTHONORMAL:
            allowed = (
                "3 rows of 3 numbers whose columns are unit vectors at right angles: the axes x, y, z in the world"
            )
            raise InvalidValueError("not orthonormal", allowed)
    return value


def check_clim(value: tuple[float, float]) -> tuple[float, float]:
    """Validate clim: low <= high; equal values are a step."""
    if value[0] > value[1]:
        raise InvalidValueError("the low end lies above the high end", "[low, high] with low <= high")
    return value


def check_points(points: Points) -> Points:
    """Validate control points: at least one, sorted by value; a repeated value is a step."""
    if not points:
        raise InvalidValueError("no control points", "at least one")
    return check_order(points)


def check_order(points: Points) -> Points:
    """Validate the order of control points by value."""
    for before, after in pairwise(points):
        if after[0] < before[0]:
            raise InvalidValueError(
                f"control points out of order: {after[0]} after {before[0]}", "points sorted by value"
            )
    return points


def check_cmap(value: Any) -> Any:
    """Validate the form of a colour map; objects of matplotlib and cmap become names or colours."""
    value = to_builtin(value)
    if callable(value) and (hasattr(value, "color_stops") or hasattr(value, "N")):
        return scene_cmap(value)
    if value is None or _is_sequence(value) or (isinstance(value, str) and value.strip()):
        return value
    allowed = (
        "a name that `clusterviz cmaps` lists, [[value, r, g, b], …], [[r, g, b], …], or a ParaView preset (.json)"
    )
    raise InvalidValueError("not a colour map", allowed)


def check_opacity(value: Any) -> Any:
    """Validate the form of an opacity: a number, a preset or control points."""
    value = to_builtin(value)
    if isinstance(value, str) and value not in PRESETS:
        raise InvalidValueError("unknown opacity preset", f"a number, [[value, opacity], …], or one of {PRESET_NAMES}")
    if isinstance(value, bool) or not (value is None or isinstance(value, (str, int, float)) or _is_sequence(value)):
        raise InvalidValueError("not an opacity", "a number in 0..1, [[value, opacity], …], or a preset such as linear")
    return value


def check_surface(value: Any) -> Any:
    """Validate the form of an isosurface: a number or a list."""
    value = to_builtin(value)
    if isinstance(value, bool) or not (isinstance(value, (int, float)) or _is_sequence(value)):
        raise InvalidValueError("not a surface", "a data value, or [value, opacity]")
    return value


def check_light(kind: str, position: Vector | None, focal_point: Vector, everywhere: bool) -> None:
    """Require a position for scene lights, and a direction unless they shine in all directions."""
    if kind == "headlight":
        return
    if position is None:
        raise InvalidValueError("missing", "where the light shines from, [x, y, z]", key="position")
    if position == focal_point and not everywhere:
        raise InvalidValueError(
            "the same as focal_point", "a point other than focal_point", key="position", found=list(position)
        )


def check_attenuation(kind: str, positional: bool, attenuation: Vector) -> None:
    """Refuse positional headlights, and attenuation by zero."""
    if positional and kind == "headlight":
        raise InvalidValueError("a headlight shines from afar", "type: scene, or positional: false", key="positional")
    if not any(attenuation):
        raise InvalidValueError("divides by nothing", "one number above 0", key="attenuation", found=list(attenuation))


def check_normal(value: Vector) -> Vector:
    """Refuse the zero vector as a direction."""
    if not any(value):
        raise InvalidValueError("the zero vector has no direction", "a direction, such as [0, 0, 1]")
    return value


def check_box(value: Bounds) -> Bounds:
    """Validate the order of bounds along each axis."""
    for axis, name in enumerate("xyz"):
        if value[2 * axis] > value[2 * axis + 1]:
            raise InvalidValueError(f"{name}min lies above {name}max", "[xmin, xmax, ymin, ymax, zmin, zmax]")
    return value


def _is_sequence(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))
