"""Keys of a scene set from outside it: -D quality.step=0.25 on the command line, step=0.25 in Python.

A key is written whole, or by its last name alone where that is unambiguous: `cmap` is `volumes.0.cmap`.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from clusterviz.errors import SceneError
from clusterviz.scene.complaints import SECTIONS, Key, key_text, section_at, unknown_key
from clusterviz.scene.kinds import Section
from clusterviz.scene.light import Light
from clusterviz.scene.transfer_2d import Transfer2d
from clusterviz.scene.values import Scene
from clusterviz.scene.yaml_text import parse_yaml, yaml_problem


@dataclass(frozen=True)
class Override:
    """One key, whole or begun by a last name, and the value that it gets; `option` is how the user wrote it."""

    key: Key
    value: Any
    option: str


def parse_overrides(options: Sequence[str]) -> tuple[Override, ...]:
    """Options as keys and values.

    Parameters
    ----------
    options : each "key=value"; keys are joined by dots, list items are numbers (volumes.0.clim or volumes[0].clim),
        and a last name alone will do (clim); the value is YAML

    Raises
    ------
    SceneError
        No "=", an unknown key, or a value that is not YAML.
    """
    return tuple(_parse(option) for option in options)


def apply_overrides(data: dict[str, Any], overrides: Sequence[Override]) -> tuple[dict[str, Any], dict[Key, str]]:
    """A copy of the scene's raw data with the overrides in it; of two for one key the later one holds.

    Returns
    -------
    data : the copy
    options : what the user wrote, by the whole key that it set

    Raises
    ------
    SceneError
        A last name that several keys of this scene have, or an item that a list lacks.
    """
    data, options = copy.deepcopy(data), {}
    for override in overrides:
        key = _whole(data, override)
        _set(data, key, override)
        options[key] = override.option
    return data, options


def parse_key(name: str, where: str) -> Key:
    """A key as people write it, volumes[0].clim or clim, in parts.

    Raises
    ------
    SceneError
        No scene has such a key.
    """
    parts = re.sub(r"\[(\d+)\]", r".\1", name.strip()).split(".")
    key: Key = tuple(int(part) if part.isascii() and part.isdigit() else part for part in parts)
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


def _check_known(key: Key, where: str) -> None:
    """Every word of the key names a field of the section before it; below a plain value only list items follow."""
    if isinstance(key[0], int):
        raise unknown_key(where, key[0], Scene)
    for end, part in enumerate(key):
        section = section_at(key[:end])
        if isinstance(part, str) and (section is None or part not in section.model_fields):
            raise unknown_key(where, part, section)


def _sections(data: dict[str, Any], *, all_of_them: bool = False) -> Iterator[tuple[Key, type[Section]]]:
    """The sections whose keys can be set by their last names: those of every scene, and what this one has more."""
    yield from SECTIONS
    lights, volumes = data.get("lights"), data.get("volumes")
    for index in range(1 if all_of_them else len(lights) if isinstance(lights, list) else 0):
        yield ("lights", index), Light
    first = volumes[0] if isinstance(volumes, list) and volumes else None
    if all_of_them or (isinstance(first, dict) and isinstance(first.get("transfer_2d"), dict)):
        yield ("volumes", 0, "transfer_2d"), Transfer2d


def _whole(data: dict[str, Any], override: Override) -> Key:
    """The key from the scene's root on."""
    name, *items = override.key
    if name in Scene.model_fields:
        return override.key
    found = [key for key, section in _sections(data) if name in section.model_fields]
    if len(found) > 1:
        allowed = ", ".join(key_text((*key, name)) for key in found)
        raise SceneError("several keys have this name", where=override.option, found=name, allowed=allowed)
    known = found or [key for key, section in _sections(data, all_of_them=True) if name in section.model_fields]
    return (*known[0], name, *items)


def _set(data: dict[str, Any], key: Key, override: Override) -> None:
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
        if isinstance(part, str) and place.get(part) is None:
            place[part] = [] if isinstance(following, int) else {}
        place = place[part]
