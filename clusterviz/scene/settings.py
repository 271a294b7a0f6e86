"""Keys of a scene by their last names, for Python: step=0.5 is quality.step, cmap="bone" is volumes[0].cmap."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from pydantic import ValidationError

from clusterviz.errors import SceneError
from clusterviz.scene.clip import Clip
from clusterviz.scene.complaints import Key, scene_error
from clusterviz.scene.kinds import Section
from clusterviz.scene.overrides import Override, apply_overrides, parse_overrides
from clusterviz.scene.values import Camera, Cluster, ImageSettings, Quality, Scene, Volume

SECTIONS: tuple[tuple[Key, type[Section]], ...] = (
    (("volumes", 0), Volume),
    (("camera",), Camera),
    (("clip",), Clip),
    (("image",), ImageSettings),
    (("quality",), Quality),
    (("cluster",), Cluster),
)
KEYS: dict[str, Key] = {name: (*key, name) for key, section in SECTIONS for name in section.model_fields}
"""Last name -> key; no name occurs in two sections."""


def with_settings(scene: Scene, settings: Mapping[str, Any]) -> Scene:
    """A copy of the scene in which some keys have other values.

    Parameters
    ----------
    scene : with a volume, where a key of volumes is set; by its last name alone it is the first volume's
    settings : values by the last names of keys, or by whole keys with dots ("volumes.1.clim"); NumPy scalars and arrays
        will do

    Raises
    ------
    SceneError
        No such key, or a value that it cannot have.
    """
    if not settings:
        return scene
    options = {_key(name): f"{name}={value!r}" for name, value in settings.items()}
    overrides = [Override(_key(name), value, options[_key(name)]) for name, value in settings.items()]
    data = apply_overrides(scene.model_dump(mode="json", exclude_unset=True), overrides)
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, "scene", options) from None


def _key(name: str) -> Key:
    if "." in name:
        return parse_overrides([f"{name}=null"])[0].key
    if name not in KEYS:
        near = get_close_matches(name, KEYS, n=1, cutoff=0.5)
        hint = f", did you mean {near[0]}?" if near else ""
        raise SceneError(f"unknown setting{hint}", where="render", found=name, allowed=", ".join(KEYS))
    return KEYS[name]
