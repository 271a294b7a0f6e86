"""Overrides of scene keys: -D quality.step=0.25 on the command line, step=0.25 in Python.

A key is given by its full path, or by its last name if that is unambiguous: `cmap` is `volumes.0.cmap`.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml
from pydantic import ValidationError

from clusterviz.content.sections import LISTED_SECTIONS
from clusterviz.errors import SceneError
from clusterviz.scene.field_types import Section, current_key
from clusterviz.scene.transfer_2d import Transfer2d
from clusterviz.scene.validation_messages import (
    KEY_PATHS,
    SECTIONS,
    KeyPath,
    format_key,
    format_value,
    scene_error,
    section_at,
    unknown_key,
)
from clusterviz.scene.values import Light, Scene, Volume
from clusterviz.scene.yaml_text import parse_yaml, yaml_problem


@dataclass(frozen=True)
class Override:
    key: KeyPath  # full path, or a path that begins with a last name
    value: Any  # the new value
    option: str  # the text of the option, for errors


def parse_overrides(options: Sequence[str]) -> tuple[Override, ...]:
    """Parse options of the form "key=value".

    `options`: "key=value"; the key is a path with dots and list indices (volumes.0.clim or volumes[0].clim), or a last
    name (clim); the value is YAML. Raises SceneError: an option lacks "=", its key is unknown, or its value is not
    YAML.
    """
    return tuple(_parse(option) for option in options)


def apply_overrides(data: dict[str, Any], overrides: Sequence[Override]) -> tuple[dict[str, Any], dict[KeyPath, str]]:
    """Apply overrides to a copy of raw scene data; later overrides take precedence.

    Returns `data`, the copy; `options`, full key path -> text of the option that set it. Raises SceneError: a last name
    is ambiguous in this scene, or a list index is out of range.
    """
    data, options = copy.deepcopy(data), {}
    for override in overrides:
        key = _resolve(data, override)
        _assign(data, key, override)
        options[key] = override.option
    return data, options


def apply_changes(data: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Set keys in a copy of raw scene data.

    `changes`: new values by full paths ("volumes.0.clim", "lights"); None removes the key, or the item of a list.
    Raises SceneError: a key is unknown, or no full path.
    """
    overrides = [Override(_full_path(name), value, name) for name, value in changes.items()]
    data, _ = apply_overrides(data, [each for each in overrides if each.value is not None])
    for override in overrides:
        if override.value is None:
            _remove(data, override.key)
    return data


def _full_path(name: str) -> KeyPath:
    key = parse_key(name, name)
    if key[0] not in Scene.model_fields:
        found = format_key(KEY_PATHS[str(key[0])]) if key[0] in KEY_PATHS else "volumes.0.clim"
        raise SceneError("not a full path of a key", where=name, found=name, allowed=f"a path, such as {found}")
    _check_known(key, name)
    return key


def _remove(data: Any, key: KeyPath) -> None:
    for part in key[:-1]:
        is_there = isinstance(part, int) and isinstance(data, list) and part < len(data)
        data = data.get(part) if isinstance(data, dict) else data[part] if is_there else None
    last = key[-1]
    if isinstance(data, dict):
        data.pop(last, None)
    elif isinstance(data, list) and isinstance(last, int) and last < len(data):
        del data[last]


def parse_key(name: str, where: str) -> KeyPath:
    """Split a key such as volumes[0].clim or clim into its parts. Raises SceneError: the key is unknown."""
    parts = re.sub(r"\[(\d+)\]", r".\1", name.strip()).split(".")
    key: KeyPath = tuple(int(part) if part.isascii() and part.isdigit() else current_key(part) for part in parts)
    if not any(key[0] in section.model_fields for _, section in _sections({}, all_of_them=True)):
        _check_known(key, where)
    return key


def _parse(option: str) -> Override:
    where = f"-D {option}"
    name, equals, text = option.partition("=")
    if not equals or not name.strip():
        raise SceneError(
            "not a key with a value", where=where, found=option, allowed="key=value, as in quality.step=0.5"
        )
    key = parse_key(name, where)
    text = text.strip()
    if text.startswith("#"):  # a colour, not a comment
        return Override(key, text, where)
    try:
        return Override(key, parse_yaml(text), where)
    except yaml.YAMLError as error:
        raise SceneError(f"not YAML: {yaml_problem(error)}", where=where, found=text) from None


def _check_known(key: KeyPath, where: str) -> None:
    """Check that each name of a key is a field of the section before it."""
    if isinstance(key[0], int):
        raise unknown_key(where, key[0], Scene)
    for end, part in enumerate(key):
        section = section_at(key[:end])
        if isinstance(part, str) and (section is None or part not in section.model_fields):
            raise unknown_key(where, part, section)


def _sections(data: dict[str, Any], *, all_of_them: bool = False) -> Iterator[tuple[KeyPath, type[Section]]]:
    """Yield the sections whose keys can be set by last name: those of all scenes, then those in lists of this one."""
    has_others_only = not data.get("volumes") and any(data.get(name) for name in LISTED_SECTIONS)
    yield from (pair for pair in SECTIONS if all_of_them or pair[1] is not Volume or not has_others_only)
    lights, volumes = data.get("lights"), data.get("volumes")
    for name, section in LISTED_SECTIONS.items():
        if all_of_them or data.get(name):
            yield (name, 0), section
    for index in range(1 if all_of_them else len(lights) if isinstance(lights, list) else 0):
        yield ("lights", index), Light
    first = volumes[0] if isinstance(volumes, list) and volumes else None
    if all_of_them or (isinstance(first, dict) and isinstance(first.get("transfer_2d"), dict)):
        yield ("volumes", 0, "transfer_2d"), Transfer2d


def _resolve(data: dict[str, Any], override: Override) -> KeyPath:
    name, *items = override.key
    if name in Scene.model_fields:
        return override.key
    found = [key for key, section in _sections(data) if name in section.model_fields]
    if len(found) > 1 and found[0][0] != "volumes":
        allowed = ", ".join(format_key((*key, name)) for key in found)
        raise SceneError("several keys have this name", where=override.option, found=name, allowed=allowed)
    known = found[:1] or [key for key, section in _sections(data, all_of_them=True) if name in section.model_fields]
    return (*known[0], name, *items)


def _assign(data: dict[str, Any], key: KeyPath, override: Override) -> None:
    place: Any = data
    for part, following in zip(key, (*key[1:], None), strict=True):
        if isinstance(part, int):
            if not isinstance(place, list) or part >= len(place):
                count = len(place) if isinstance(place, list) else 0
                allowed = f"0 to {count - 1}" if count else "nothing: the list is empty"
                raise SceneError("no such item in the list", where=override.option, found=part, allowed=allowed)
        elif not isinstance(place, dict):
            what = "a list item has no number" if isinstance(place, list) else "not a section"
            raise SceneError(f"{what} before {part}", where=override.option, allowed="volumes.0.path, for example")
        if following is None:
            place[part] = override.value
            return
        # A section that is true is on with its defaults.
        if isinstance(part, str) and (place.get(part) is None or place[part] is True):
            place[part] = [] if isinstance(following, int) else {}
        place = place[part]


def with_settings(scene: Scene, settings: Mapping[str, Any]) -> Scene:
    """Return a copy of a scene with other values of some keys.

    Raises SceneError: a key is unknown or ambiguous, or a value is invalid.

    Parameters
    ----------
    scene : the scene; it needs a volume if a key of volumes is set
    settings : values by last names of keys (of a volume, the first one's), by full paths ("volumes.1.clim") or by
        sections (camera, lights); a section is a dict or a value such as Camera(...); NumPy scalars and arrays are
        accepted
    """
    if not settings:
        return scene
    overrides = []
    for name, value in settings.items():
        data = _to_data(value)
        option = f"{name}={format_value(data)}"
        overrides.append(Override(parse_key(name, option), data, option))
    data, options = apply_overrides(scene.model_dump(mode="json", exclude_unset=True), overrides)
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, "scene", options) from None


def _to_data(value: Any) -> Any:
    """Return a value with all sections in it as dicts of their set keys."""
    if isinstance(value, Section):
        return value.model_dump(mode="json", exclude_unset=True)
    if isinstance(value, dict):
        return {key: _to_data(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_data(each) for each in value]
    return value
