"""Keys of a scene as keyword arguments, for Python: step=0.5 is quality.step, cmap="bone" is volumes[0].cmap."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from clusterviz.scene.complaints import scene_error, shown
from clusterviz.scene.kinds import Section
from clusterviz.scene.overrides import Override, apply_overrides, parse_key
from clusterviz.scene.values import Scene


def with_settings(scene: Scene, settings: Mapping[str, Any]) -> Scene:
    """A copy of the scene in which some keys have other values.

    Parameters
    ----------
    scene : with a volume, where a key of volumes is set; by its last name alone it is the first volume's
    settings : values by the last names of keys, by whole keys with dots ("volumes.1.clim"), or by the names of whole
        sections (camera, lights); a section is a dict or a value such as Camera(...); NumPy scalars and arrays will do

    Raises
    ------
    SceneError
        No such key, one that several keys could be, or a value that it cannot have.
    """
    if not settings:
        return scene
    overrides = []
    for name, value in settings.items():
        plain = _plain(value)
        option = f"{name}={shown(plain)}"
        overrides.append(Override(parse_key(name, option), plain, option))
    data, options = apply_overrides(scene.model_dump(mode="json", exclude_unset=True), overrides)
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, "scene", options) from None


def _plain(value: Any) -> Any:
    """Sections as dicts of what they say, in lists and dicts, too."""
    if isinstance(value, Section):
        return value.model_dump(mode="json", exclude_unset=True)
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return value
