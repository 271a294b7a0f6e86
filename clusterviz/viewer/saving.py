"""Files that a client may save: scene, picture, camera path, and the command line of a picture."""

from __future__ import annotations

import json
import shlex
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.sections import CONTENT_SECTIONS
from clusterviz.data import open_scene
from clusterviz.errors import ClustervizError, without_secrets
from clusterviz.frame.picture_file import write_picture
from clusterviz.report.provenance import Provenance
from clusterviz.scene.text import commented_scene
from clusterviz.scene.values import Scene
from clusterviz.scene.yaml_text import write_yaml
from clusterviz.viewer.describe import Content
from clusterviz.viewer.messages import KeyPose
from clusterviz.viewer.scene_client import changed_keys

MOST_TRIES = 4
"""Attempts to find overrides, each of which adds those that the ones before have made necessary."""


def scene_file(scene: Scene) -> bytes:
    """Return a completed scene as a scene file."""
    return commented_scene(scene, ["Saved from the live view of clusterviz."]).encode()


def picture_file(image: NDArray[np.float32], scene: Scene, made: Provenance, kind: Literal["png", "npz"]) -> bytes:
    """Return a picture as the file that `render` writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"picture.{kind}"
        write_picture(path, image, scene, made)
        return path.read_bytes()


def path_file(keys: Sequence[KeyPose]) -> bytes:
    """Return key frames of a camera as a path for `animate --path`."""
    frames = [{"time": key.time, **key.camera.model_dump(mode="json", exclude_none=True)} for key in keys]
    return write_yaml({"camera": frames}).encode()


@dataclass(frozen=True)
class OpenedAs:
    """File that was opened, with its overrides and its preset."""

    name: str
    overrides: tuple[str, ...] = ()
    preset: str | None = None


def command_line(file: OpenedAs, scene: Scene, content: Content) -> str:
    """Return the command line that renders a scene, with the keys that differ from those of the opened file.

    `scene`: completed. Raises ClustervizError: the scene cannot be told by overrides.
    """
    first = open_scene(file.name, file.overrides, file.preset)
    if any(len(getattr(first, name)) != len(getattr(scene, name)) for name in CONTENT_SECTIONS):
        raise ClustervizError("entries are hidden or added, which no command line can tell: save the scene as a file")
    wanted = _drawn_part(scene)
    found: dict[str, Any] = {}
    for _ in range(MOST_TRIES):
        options = [*file.overrides, *(f"{key}={json.dumps(value)}" for key, value in found.items())]
        opened = content.complete(open_scene(file.name, options, file.preset))
        missing = changed_keys(_drawn_part(opened), wanted)
        if not missing:
            words = ["clusterviz", "render", file.name, *(["--preset", file.preset] if file.preset else [])]
            words += [word for option in options for word in ("-D", option)]
            return without_secrets(shlex.join([*words, "-o", "picture.png"]))
        found |= missing
    raise ClustervizError("this scene has no command line: save the scene as a file")


def _drawn_part(scene: Scene) -> dict[str, Any]:
    return scene.model_dump(mode="json", exclude={"cluster", "automatic"})
