"""Completed scenes as text: YAML with a comment for each key, and a line for the end of a render."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import yaml

from clusterviz.scene.kinds import Section
from clusterviz.scene.values import Scene, Volume
from clusterviz.scene.yaml_text import SceneDumper, write_yaml

LONGEST = 80
"""Characters of a comment."""


def commented_scene(scene: Scene, notes: Sequence[str] = ()) -> str:
    """YAML text from which `load_scene` makes an equal scene, each key with what it means.

    Parameters
    ----------
    scene : keys that are null or an empty list by default, and still are, are left out
    notes : lines for the head of the file
    """
    lines = [f"# {note}" for note in notes]
    for name in Scene.model_fields:
        value = getattr(scene, name)
        keys = _keys(value, "  ") if isinstance(value, Section) else []
        if keys:
            lines += [f"{name}:", *keys]
        elif isinstance(value, tuple):
            parts = [_keys(part, "    ") for part in value]
            lines += (
                [f"{name}: []" if name == "volumes" and not parts else f"{name}:"] if parts or name == "volumes" else []
            )
            lines += [line for part in parts for line in (f"  - {part[0].lstrip()}", *part[1:])]
    return "\n".join(lines) + "\n"


def shown_scene(scene: Scene) -> str:
    """What a completed scene shows, on one line: range, colours and opacity of each volume, and the camera."""
    camera = scene.camera
    seen = f"parallel_scale {camera.parallel_scale:g}" if camera.parallel_scale else f"view_angle {camera.view_angle:g}"
    parts = [*map(_volume, scene.volumes), f"camera {_point(camera.position)} to {_point(camera.focal_point)}, {seen}"]
    return "; ".join(parts)


def scene_for_picture(scene: Scene) -> str:
    """The YAML text that a picture carries: all that it depends on, and so nothing of the section `cluster`."""
    return write_yaml(scene.model_dump(mode="json", exclude={"cluster"}))


def _keys(section: Section, indent: str) -> list[str]:
    lines = []
    data = section.model_dump(mode="json")
    for name, field in type(section).model_fields.items():
        value = data[name]
        if value in (None, [], {}) and name != "path":
            continue
        text = yaml.dump({name: value}, Dumper=SceneDumper, default_flow_style=True, allow_unicode=True, width=1 << 30)
        meaning = re.split(r"[;.] |[;.]$| \(|, relative", field.description or "")[0]
        short = meaning if len(meaning) <= LONGEST else meaning[: meaning.rfind(" ", 0, LONGEST)] + " …"
        lines.append(f"{indent}{text.strip()[1:-1]}  # {short}")
    return lines


def _volume(volume: Volume) -> str:
    opacity: Any = volume.opacity
    if volume.transfer_2d is not None:
        opacity = "of transfer_2d"
    elif volume.blending == "isosurface":
        opacity = f"of isosurfaces {', '.join(f'{_value(each):g}' for each in volume.isosurfaces)}"
    elif isinstance(opacity, tuple):
        opacity = " ".join(f"{value:g}:{alpha:g}" for value, alpha in _thinned(opacity))
    low, high = volume.clim or (0.0, 0.0)
    cmap = volume.cmap if isinstance(volume.cmap, str) else f"{len(volume.cmap or ())} colours"
    return f"clim {low:g} to {high:g} ({cmap}), opacity {opacity}"


def _thinned(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    return list(points) if len(points) <= 6 else [*points[:3], *points[-3:]]


def _value(surface: Any) -> float:
    return float(surface[0] if isinstance(surface, tuple) else surface)


def _point(point: Sequence[float] | None) -> str:
    return f"({', '.join(f'{value:.4g}' for value in point or ())})"
