"""Completed scenes as text: commented YAML, one-line summaries, and metadata of pictures."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import yaml

from clusterviz.errors import public_address, without_secrets
from clusterviz.scene.field_types import Section
from clusterviz.scene.files import change_paths, public_data
from clusterviz.scene.values import Scene
from clusterviz.scene.yaml_text import SceneDumper, write_yaml

MAX_COMMENT = 80
"""Largest length of a comment, characters."""


def commented_scene(scene: Scene, notes: Sequence[str] = ()) -> str:
    """Return a scene as YAML with a comment for each key; `load_scene` reads it back as an equal scene.

    `scene`: keys that are null or empty are left out; `notes`: lines of the file's leading comment.
    """
    lines = [f"# {without_secrets(' '.join(note.splitlines()))}" for note in notes]
    for name in Scene.model_fields:
        value = getattr(scene, name)
        own = [item for item in value if not getattr(item, "of_flow", False)] if isinstance(value, tuple) else []
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


def picture_metadata(scene: Scene, folder: Path) -> str:
    """Return the YAML text embedded in a picture: all sections but `cluster`, on which pictures do not depend.

    `folder`: of the picture, absolute; see `portable_path`.
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
