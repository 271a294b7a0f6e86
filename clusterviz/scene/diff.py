"""Differences between two scenes, key by key."""

from __future__ import annotations

from typing import Any

from clusterviz.content.geometry.section import GEOMETRY_SECTIONS
from clusterviz.errors import SceneError
from clusterviz.scene.field_types import Section
from clusterviz.scene.validation_messages import format_value
from clusterviz.scene.values import Scene

OPENED = ("path", "array", "channel", "detail", "labels", "spacing", "origin", "direction")
"""Keys of a volume that frames share, like all keys of the cluster. The other ones may differ between frames, and so do
all keys of camera, picture, lights, clip and quality, as far as bricks have the margins that they need."""
GEOMETRY_CHANGING = (
    "color",
    "cmap",
    "clim",
    "opacity",
    "culling",
    "edges",
    "ambient",
    "diffuse",
    "specular",
    "specular_power",
)
"""Keys of meshes, lines and points that may differ between frames: those on which neither bricks nor their primitives
depend, as they do on radius, transform, scalars and shading."""

GRID_CHANGING = (
    "cmap",
    "clim",
    "opacity",
    "opacity_unit_distance",
    "ambient",
    "diffuse",
    "specular",
    "specular_power",
    "visibility",
)
"""Keys of unstructured grids that may differ between frames."""
FLOW_CHANGING = (
    "cmap",
    "clim",
    "opacity",
    "speed_opacity",
    "opacity_unit_distance",
    "color",
    "ambient",
    "diffuse",
    "specular",
    "specular_power",
)
"""Keys of flows that may differ between frames."""


def differences(before: Any, after: Any, key: str = "") -> list[str]:
    """Return a line "key: was …, is …" for each leaf in which two trees of dicts and lists differ."""
    if isinstance(before, dict) and isinstance(after, dict):
        names = dict.fromkeys([*before, *after])
        return [
            line
            for name in names
            for line in differences(before.get(name), after.get(name), f"{key}.{name}" if key else str(name))
        ]
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        if all(isinstance(item, (int, float)) for item in (*before, *after)):
            return [] if before == after else [f"{key}: was {format_value(before)}, is {format_value(after)}"]
        pairs = enumerate(zip(before, after, strict=True))
        return [line for index, (a, b) in pairs for line in differences(a, b, f"{key}[{index}]")]
    return [] if before == after else [f"{key}: was {format_value(before)}, is {format_value(after)}"]


def is_same_volume(first: Scene, scene: Scene) -> bool:
    """Return whether two scenes may be frames of the same loop."""
    return scene is first or _shared_values(first) == _shared_values(scene)


def check_same_volume(first: Scene, scene: Scene) -> None:
    """Refuse a frame that differs from the first in content that has been opened, or in the distribution of the work.

    Raises
    ------
    SceneError
        The error names the first key that differs.
    """
    if not is_same_volume(first, scene):
        found = differences(_shared_part(first), _shared_part(scene))
        allowed = f"another view or quality, or keys of a volume but {', '.join(OPENED)}"
        allowed += f", or {', '.join(GEOMETRY_CHANGING)} of geometry" if scene.geometry else ""
        allowed += f", or {', '.join(GRID_CHANGING)} of grids" if scene.grids else ""
        allowed += f", or {', '.join(FLOW_CHANGING)} of flows" if scene.flows else ""
        raise SceneError("frames differ in more than they can", found=found[0], allowed=allowed)


def _shared_entries(scene: Scene) -> dict[str, list[tuple[Section, list[str]]]]:
    """Return the entries of each list of a scene, with the keys that all frames share."""
    geometry = {name: getattr(scene, name) for name in GEOMETRY_SECTIONS}
    return {
        "volumes": [(volume, list(OPENED)) for volume in scene.volumes],
        **{
            name: [(each, _other_keys(each, GEOMETRY_CHANGING)) for each in entries]
            for name, entries in geometry.items()
        },
        "grids": [(grid, _other_keys(grid, GRID_CHANGING)) for grid in scene.grids],
        "flows": [(flow, _other_keys(flow, FLOW_CHANGING)) for flow in scene.flows],
    }


def _other_keys(section: Section, changing: tuple[str, ...]) -> list[str]:
    return [key for key in type(section).model_fields if key not in changing]


def _shared_values(scene: Scene) -> list[object]:
    """Return the values of all keys that frames share; quicker than `_shared_part`."""
    entries = _shared_entries(scene).values()
    return [scene.cluster, *([[getattr(one, key) for key in keys] for one, keys in each] for each in entries)]


def _shared_part(scene: Scene) -> dict[str, object]:
    """Return the part of a scene that all frames share, as data."""
    entries = _shared_entries(scene).items()
    found = {name: [one.model_dump(mode="json", include=set(keys)) for one, keys in each] for name, each in entries}
    return {**found, "cluster": scene.cluster.model_dump(mode="json")}
