"""Differences between two scenes, key by key."""

from __future__ import annotations

from typing import Any

from clusterviz.content.table import KINDS, entries_of
from clusterviz.errors import SceneError
from clusterviz.scene.field_types import Section
from clusterviz.scene.validation_messages import format_value
from clusterviz.scene.values import Scene


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
        allowed = ["another view or quality"]
        for kind in KINDS:
            if kind.opened:
                allowed.append(f"keys of a {kind.name.removesuffix('s')} but {', '.join(kind.opened)}")
            elif getattr(scene, kind.name):
                allowed.append(f"{', '.join(kind.changing)} of {kind.name}")
        raise SceneError("frames differ in more than they can", found=found[0], allowed=", or ".join(allowed))


def _shared_entries(scene: Scene) -> dict[str, list[tuple[Section, list[str]]]]:
    found: dict[str, list[tuple[Section, list[str]]]] = {name: [] for kind in KINDS for name in kind.sections}
    for entry in entries_of(scene):
        kind, known = entry.kind, type(entry.section).model_fields
        keys = list(kind.opened) or [key for key in known if key not in kind.changing]
        found[entry.key.partition("[")[0]].append((entry.section, keys))
    return found


def _shared_values(scene: Scene) -> list[object]:
    """Return the values of all keys that frames share; quicker than `_shared_part`."""
    entries = _shared_entries(scene).values()
    return [scene.cluster, *([[getattr(one, key) for key in keys] for one, keys in each] for each in entries)]


def _shared_part(scene: Scene) -> dict[str, object]:
    """Return the part of a scene that all frames share, as data."""
    entries = _shared_entries(scene).items()
    found = {name: [one.model_dump(mode="json", include=set(keys)) for one, keys in each] for name, each in entries}
    return {**found, "cluster": scene.cluster.model_dump(mode="json")}
