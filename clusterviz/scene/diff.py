"""Differences between two scenes, key by key."""

from __future__ import annotations

from typing import Any

from clusterviz.errors import SceneError
from clusterviz.scene.geometry import as_sections
from clusterviz.scene.validation_messages import format_value
from clusterviz.scene.values import Camera, Clip, ImageSettings, Quality, Scene, Volume

OPENED = ("path", "array", "channel", "detail", "spacing", "origin", "direction")
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
    return scene == first or _shared_part(first) == _shared_part(scene)


def check_same_volume(first: Scene, scene: Scene) -> None:
    """Refuse a frame that differs from the first in content that has been opened, or in the distribution of the work.

    Raises
    ------
    SceneError
        The error names the first key that differs.
    """
    found = differences(_shared_part(first), _shared_part(scene)) if scene != first else []
    if found:
        allowed = f"another view or quality, or keys of a volume but {', '.join(OPENED)}"
        allowed += f", or {', '.join(GEOMETRY_CHANGING)} of geometry" if scene.geometry else ""
        allowed += f", or {', '.join(GRID_CHANGING)} of grids" if scene.grids else ""
        raise SceneError("frames differ in more than they can", found=found[0], allowed=allowed)


def _shared_part(scene: Scene) -> dict[str, Any]:
    """Return the part of a scene that all frames share."""
    keys = set(Volume.model_fields) - set(OPENED)
    volumes = tuple(volume.model_copy(update=dict.fromkeys(keys)) for volume in scene.volumes)
    geometry = as_sections(
        section.model_copy(update={key: None for key in GEOMETRY_CHANGING if key in type(section).model_fields})
        for section in scene.geometry
    )
    grids = tuple(grid.model_copy(update=dict.fromkeys(GRID_CHANGING)) for grid in scene.grids)
    view = {"camera": Camera(), "image": ImageSettings(), "clip": Clip(), "lights": (), "quality": Quality()}
    update = {**view, "volumes": volumes, "grids": grids, **geometry}
    return scene.model_copy(update=update).model_dump(mode="json", warnings=False)
