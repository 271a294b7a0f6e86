"""Errors of the scene as a user reads them: file, key, what is wrong, what was found, what is allowed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from clusterviz.errors import SceneError
from clusterviz.scene.checks import UnusableError
from clusterviz.scene.clip import Clip
from clusterviz.scene.kinds import EXPLAIN, Section
from clusterviz.scene.values import Camera, Cluster, ImageSettings, Quality, Scene, Volume

Key = tuple[str | int, ...]
SECTIONS: tuple[tuple[Key, type[Section]], ...] = (
    (("volumes", 0), Volume),
    (("camera",), Camera),
    (("clip",), Clip),
    (("image",), ImageSettings),
    (("quality",), Quality),
    (("cluster",), Cluster),
)
KEYS: dict[str, Key] = {name: (*key, name) for key, section in SECTIONS for name in section.model_fields}
"""Last name -> key; no name occurs in two of these sections."""
SHOWN = 8
"""How many errors are listed before the rest is only counted."""

TYPES = {
    "float_type": ("not a number", "a number"),
    "int_type": ("not a whole number", "a whole number"),
    "int_from_float": ("not a whole number", "a whole number"),
    "string_type": ("not a text", "a text (in quotes where it looks like a number or a date)"),
    "bool_type": ("not a switch", "true, false"),
    "finite_number": ("not finite", "a finite number"),
}
LISTS = {"missing": "missing", "tuple_type": "not a list", "too_short": "too few values", "too_long": "too many values"}
BOUNDS = {
    "greater_than": ("too small", "more than", "gt"),
    "greater_than_equal": ("too small", "at least", "ge"),
    "less_than": ("too large", "less than", "lt"),
    "less_than_equal": ("too large", "at most", "le"),
}


def scene_error(
    error: ValidationError, where: str, options: Mapping[Key, str] | None = None, root: type[Section] = Scene
) -> SceneError:
    """All complaints of a validation in one error, a line each.

    Parameters
    ----------
    error : what pydantic found
    where : the scene file, or what stands for it
    options : the text of the command-line option that set a key, by key; it is named in place of the file
    root : what was validated
    """
    found = {str(_complaint(details, where, options or {}, root)): None for details in error.errors()}
    lines = list(found)[:SHOWN]
    if len(found) > SHOWN:
        lines.append(f"and {len(found) - SHOWN} more errors")
    return SceneError("\n".join(lines))


EXPLAIN.append(scene_error)


def key_text(key: Key) -> str:
    """A key as people write it: volumes[0].clim; the tags of unions are left out."""
    text = ""
    for part in key:
        if isinstance(part, int):
            text += f"[{part}]"
        elif not part.startswith("<"):
            text += f".{part}" if text else part
    return text


def unknown_key(where: str, name: object, section: type[Section] | None) -> SceneError:
    """The error for a key that no section has, with the nearest one that this section has, or where else it is."""
    known = list(section.model_fields) if section else []
    elsewhere = KEYS if section is Scene or any(section is other for _, other in SECTIONS) else {}
    word = str(name)
    tries = ((elsewhere, 1.0), (known, 0.7), (elsewhere, 0.7), (known, 0.5))
    near = next((found[0] for names, cutoff in tries if (found := get_close_matches(word, names, 1, cutoff))), None)
    hint = f", did you mean {near if near in known else key_text(elsewhere[near])}?" if near else ""
    return SceneError(f"unknown key{hint}", where=where, found=name, allowed=", ".join(known) or None)


def section_at(key: Key, root: type[Section] = Scene) -> type[Section] | None:
    """The section that a key leads to, None if it leads to a plain value or nowhere."""
    section = root
    for part in key:
        if isinstance(part, int):
            continue
        field = section.model_fields.get(part)
        inner = _section_in(field.annotation) if field else None
        if inner is None:
            return None
        section = inner
    return section


def shown(value: Any) -> str:
    """A found value on one line, cut where it is long."""
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except (TypeError, ValueError):
        text = str(value)
    return text if len(text) <= 80 else text[:77] + "…"


def _section_in(annotation: Any) -> type[Section] | None:
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, Section):
            return candidate
    return None


def _complaint(details: ErrorDetails, where: str, options: Mapping[Key, str], root: type[Section]) -> SceneError:
    kind, key, context = details["type"], details["loc"], details.get("ctx", {})
    found: str | None = None if kind == "missing" else shown(details["input"])
    cause = context.get("error")
    if isinstance(cause, UnusableError):
        if cause.key:  # the input is the whole section then, which says nothing of this key
            key, found = (*key, cause.key), None
        found = shown(cause.found) if cause.found is not None else found
        return SceneError(cause.what, where=_place(key, where, options), found=found, allowed=cause.allowed)
    if kind == "missing" and isinstance(key[-1], int):  # an item, whose list is the input
        kind, key, found = "too_short", key[:-1], shown(details["input"])
    place = _place(key, where, options)
    if kind == "extra_forbidden":
        return unknown_key(place, key[-1], section_at(key[:-1], root))
    what, allowed = _words(kind, key, details["msg"], context, root)
    return SceneError(what, where=place, found=found, allowed=allowed)


def _words(
    kind: str, key: Key, message: str, context: Mapping[str, Any], root: type[Section]
) -> tuple[str, str | None]:
    """What is wrong and what is allowed, for pydantic's own kinds of error."""
    if kind in TYPES:
        return TYPES[kind]
    if kind in BOUNDS:
        what, relation, bound = BOUNDS[kind]
        return what, f"{relation} {context[bound]:g}"
    if kind == "literal_error":
        return "not one of the choices", context["expected"].replace("'", "").replace(" or ", ", ")
    if kind == "too_long" and key == ("volumes",):
        return "too many volumes", f"at most {context['max_length']}"
    if kind in LISTS:
        example = _example(key, root)
        most = f"at most {context['max_length']} values" if kind == "too_long" else "a list"
        most = "a value" if kind == "missing" else most
        return LISTS[kind], most if example is None else f"{most}, such as {shown(example)}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        section = section_at(key, root)
        return "not a section", f"keys with values: {', '.join(section.model_fields) if section else ''}"
    return message[:1].lower() + message[1:], None


def _example(key: Key, root: type[Section]) -> Any:
    """What a key, or an item of its list, may hold, from the examples of its field; None where it has none."""
    words = [part for part in key if isinstance(part, int) or not part.startswith("<")]
    last = max((place for place, part in enumerate(words) if isinstance(part, str)), default=-1)
    section = section_at(tuple(words[:last]), root) if last >= 0 else None
    field = section.model_fields.get(str(words[last])) if section else None
    found = (field.examples or _examples_in(field.annotation)) if field else None
    example: Any = found[0] if found else None
    for _ in words[last + 1 :]:
        example = example[0] if isinstance(example, list) else None
    return example


def _examples_in(annotation: Any) -> list[Any] | None:
    """The examples that come with a type, or with one of those that it is made of."""
    if isinstance(annotation, FieldInfo):
        return annotation.examples
    parts = sorted(get_args(annotation), key=lambda part: not isinstance(part, FieldInfo))
    return next((found for part in parts if (found := _examples_in(part))), None)


def _place(key: Key, where: str, options: Mapping[Key, str]) -> str:
    for end in range(len(key), 0, -1):
        if key[:end] in options:
            return f"{options[key[:end]]}: {key_text(key)}"
    return f"{where}: {key_text(key)}" if key else where
