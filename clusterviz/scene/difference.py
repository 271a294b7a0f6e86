"""How two scenes differ, in words: for frames that must show one volume, and for animations that are taken up again."""

from __future__ import annotations

from typing import Any

from clusterviz.errors import SceneError
from clusterviz.scene.complaints import shown
from clusterviz.scene.values import Camera, Quality, Scene

CHANGING = ("cmap", "clim", "opacity", "opacity_unit_distance", "threshold")
"""Keys of a volume that may differ from frame to frame; so may the camera, and quality."""


def differences(before: Any, after: Any, key: str = "") -> list[str]:
    """Every leaf in which two trees of dicts, lists and plain values differ: "key: was …, is …"."""
    if isinstance(before, dict) and isinstance(after, dict):
        names = dict.fromkeys([*before, *after])
        return [
            line
            for name in names
            for line in differences(before.get(name), after.get(name), f"{key}.{name}" if key else str(name))
        ]
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        if all(isinstance(item, (int, float)) for item in (*before, *after)):
            return [] if before == after else [f"{key}: was {shown(before)}, is {shown(after)}"]
        pairs = enumerate(zip(before, after, strict=True))
        return [line for index, (a, b) in pairs for line in differences(a, b, f"{key}[{index}]")]
    return [] if before == after else [f"{key}: was {shown(before)}, is {shown(after)}"]


def check_same_volume(first: Scene, scene: Scene) -> None:
    """Refuse a frame that differs from the first one in more than camera, transfer function and quality.

    Raises
    ------
    SceneError
        With the first key that differs.
    """
    found = differences(_fixed(first), _fixed(scene)) if scene != first else []
    if found:
        allowed = f"another camera or quality, or {', '.join(CHANGING)} of a volume"
        raise SceneError("frames differ in more than they can", found=found[0], allowed=allowed)


def _fixed(scene: Scene) -> dict[str, Any]:
    """What all frames have in common."""
    volumes = tuple(volume.model_copy(update=dict.fromkeys(CHANGING)) for volume in scene.volumes)
    return scene.model_copy(update={"camera": Camera(), "volumes": volumes, "quality": Quality()}).model_dump(
        mode="json"
    )
