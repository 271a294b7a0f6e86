"""Options of the form -D quality.step=0.25: any key of a scene, set from the command line."""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from clusterviz.errors import SceneError
from clusterviz.scene.complaints import Key, section_at, unknown_key
from clusterviz.scene.yaml_text import parse_yaml, yaml_problem


@dataclass(frozen=True)
class Override:
    """One key and the value that it gets; `option` is how the user wrote it."""

    key: Key
    value: Any
    option: str


def parse_overrides(options: Sequence[str]) -> tuple[Override, ...]:
    """Options as keys and values.

    Parameters
    ----------
    options : each "key=value"; keys are joined by dots, list items are numbers (volumes.0.clim or volumes[0].clim);
        the value is YAML

    Raises
    ------
    SceneError
        No "=", an unknown key, or a value that is not YAML.
    """
    return tuple(_parse(option) for option in options)


def apply_overrides(data: dict[str, Any], overrides: Sequence[Override]) -> dict[str, Any]:
    """A copy of the scene's raw data with the overrides in it; of two for one key the later one holds."""
    data = copy.deepcopy(data)
    for override in overrides:
        _set(data, override)
    return data


def _parse(option: str) -> Override:
    where = f"-D {option}"
    name, equals, text = option.partition("=")
    if not equals or not name.strip():
        raise SceneError(
            "not a key with a value", where=where, found=option, allowed="key=value, as in quality.step=0.5"
        )
    parts = re.sub(r"\[(\d+)\]", r".\1", name.strip()).split(".")
    key: Key = tuple(int(part) if part.isascii() and part.isdigit() else part for part in parts)
    _check_known(key, where)
    text = text.strip()
    if text.startswith("#"):  # a colour, not a comment
        return Override(key, text, where)
    try:
        return Override(key, parse_yaml(text), where)
    except yaml.YAMLError as error:
        raise SceneError(f"not YAML: {yaml_problem(error)}", where=where, found=text) from None


def _check_known(key: Key, where: str) -> None:
    """Every word of the key names a field of the section before it; below a plain value only list items follow."""
    for end, part in enumerate(key):
        section = section_at(key[:end])
        if isinstance(part, str) and (section is None or part not in section.model_fields):
            raise unknown_key(where, part, section)


def _set(data: dict[str, Any], override: Override) -> None:
    place: Any = data
    for part, following in zip(override.key, (*override.key[1:], None), strict=True):
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
