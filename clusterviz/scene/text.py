"""Completed scenes as text: commented YAML, one-line summaries, and metadata of pictures."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from clusterviz.content.flow.section import FlowSection
from clusterviz.content.geometry.section import GeometrySection, LinesSection, PointsSection
from clusterviz.errors import public_address, without_secrets
from clusterviz.scene.blend_modes import BLEND_MODES
from clusterviz.scene.field_types import Section
from clusterviz.scene.files import change_paths, public_data
from clusterviz.scene.values import Scene, Volume
from clusterviz.scene.yaml_text import SceneDumper, write_yaml

MAX_COMMENT = 80
"""Largest length of a comment, characters."""


def commented_scene(scene: Scene, notes: Sequence[str] = ()) -> str:
    """Return a scene as YAML with a comment for each key; `load_scene` reads it back as an equal scene.

    Parameters
    ----------
    scene : keys that are null or empty are left out
    notes : lines of the file's leading comment
    """
    lines = [f"# {without_secrets(' '.join(note.splitlines()))}" for note in notes]
    for name in Scene.model_fields:
        value = getattr(scene, name)
        own = [item for item in value if not item.of_flow] if isinstance(value, tuple) else []
        items = [_key_lines(item, "    ") for item in own]
        if items:
            lines.append(f"{name}:")
            for item in items:
                lines += [f"  - {item[0].lstrip()}", *item[1:]]
        elif name == "volumes":
            lines.append("volumes: []")
        elif isinstance(value, Section) and (keys := _key_lines(value, "  ")):
            lines += [f"{name}:", *keys]
    return "\n".join(lines) + "\n"


def scene_summary(scene: Scene) -> str:
    """Return a completed scene on one line: how volumes, geometry and grids look, and the camera."""
    camera = scene.camera
    seen = f"parallel_scale {camera.parallel_scale:g}" if camera.parallel_scale else f"view_angle {camera.view_angle:g}"
    parts = [
        *(_volume_summary(volume) for volume in scene.volumes if not volume.of_flow),
        *(
            _geometry_summary(key, section)
            for key, section in zip(scene.geometry_keys, scene.geometry, strict=True)
            if not section.of_flow
        ),
        *(f"grids[{n}] {_transfer_summary(one.clim, one.cmap, one.opacity)}" for n, one in enumerate(scene.grids)),
        *(f"flows[{n}] {_flow_summary(one)}" for n, one in enumerate(scene.flows)),
        f"camera {_format_point(camera.position)} to {_format_point(camera.focal_point)}, {seen}",
    ]
    return "; ".join(parts)


def chosen_arrays(scene: Scene, completed: Scene) -> list[str]:
    """Return a line on each array of geometry that automatic settings have taken, with how to take another."""
    now, found = dict(zip(completed.geometry_keys, completed.geometry, strict=True)), []
    for key, section in zip(scene.geometry_keys, scene.geometry, strict=True):
        if section.scalars is None and now[key].scalars is not None:
            option = key.replace("[", ".").replace("]", "")
            another = f"another array: -D {option}.scalars=NAME, one colour: -D {option}.color=white"
            found.append(f"{key} has the colours of its array {now[key].scalars}; {another}")
    return found


def picture_metadata(scene: Scene, folder: Path) -> str:
    """Return the YAML text embedded in a picture: all sections but `cluster`, on which pictures do not depend.

    Parameters
    ----------
    folder : of the picture, absolute; see `portable_path`
    """
    data = public_data(scene, {"cluster"})
    return write_yaml(change_paths(data, lambda path: portable_path(path, folder)))


def portable_path(path: str, folder: Path) -> str:
    """Return a path relative to a folder if both share another folder than the root; else to ~, else as it is."""
    if not os.path.isabs(path):  # data in memory
        return path
    if os.path.commonpath([path, folder]) != os.sep:
        return os.path.relpath(path, folder)
    with suppress(ValueError, RuntimeError):
        return f"~/{Path(path).relative_to(Path.home())}"
    return path


def _key_lines(section: Section, indent: str) -> list[str]:
    lines = []
    data = section.model_dump(mode="json")
    for name, field in type(section).model_fields.items():
        value = data[name]
        if value in (None, [], {}) and name != "path":
            continue
        value = public_address(value) if name == "path" else value
        text = yaml.dump({name: value}, Dumper=SceneDumper, default_flow_style=True, allow_unicode=True, width=1 << 30)
        meaning = re.split(r"[;.] |[;.]$| \(|, relative", field.description or "")[0]
        short = meaning if len(meaning) <= MAX_COMMENT else meaning[: meaning.rfind(" ", 0, MAX_COMMENT)] + " …"
        lines.append(f"{indent}{text.strip()[1:-1]}  # {short}")
    return lines


def _volume_summary(volume: Volume) -> str:
    opacity: Any = volume.opacity
    if volume.optics is not None:
        at = volume.optics.wavelengths
        return f"optics at {len(at)} wavelengths, {at[0]:g} to {at[-1]:g} nm"
    if volume.transfer_2d is not None:
        opacity = "of transfer_2d"
    elif BLEND_MODES[volume.blending].only_surfaces:
        opacity = f"of isosurfaces {', '.join(f'{_surface_value(each):g}' for each in volume.isosurfaces)}"
    return _transfer_summary(volume.clim, volume.shader or volume.cmap, opacity)


def _transfer_summary(clim: tuple[float, float] | None, cmap: Any, opacity: Any) -> str:
    low, high = clim or (0.0, 0.0)
    colours = cmap if isinstance(cmap, str) else f"{len(cmap or ())} colours"
    if isinstance(opacity, tuple):
        opacity = " ".join(f"{value:g}:{alpha:g}" for value, alpha in _abbreviated(opacity))
    return f"clim {low:g} to {high:g} ({colours}), opacity {opacity}"


def _geometry_summary(key: str, section: GeometrySection) -> str:
    colour = section.scalars or section.color
    radius = f", radius {_format_value(section.radius)}" if isinstance(section, (LinesSection, PointsSection)) else ""
    return f"{key} {_format_value(colour)}, opacity {_format_value(section.opacity)}{radius}"


def _flow_summary(flow: FlowSection) -> str:
    return f"{flow.show}, {_transfer_summary(flow.clim, flow.cmap, flow.opacity)}"


def _format_value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"{len(value)} points" if isinstance(value[0], tuple) else f"({', '.join(f'{v:g}' for v in value)})"
    return value if isinstance(value, str) else f"{value:g}"


def _abbreviated(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    return list(points) if len(points) <= 6 else [*points[:3], *points[-3:]]


def _surface_value(surface: Any) -> float:
    return float(surface[0] if isinstance(surface, tuple) else surface)


def _format_point(point: Sequence[float] | None) -> str:
    return f"({', '.join(f'{value:.4g}' for value in point or ())})"
