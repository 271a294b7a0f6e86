"""Messages of validation errors: file, key, problem, value found, values allowed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from clusterviz.errors import SceneError
from clusterviz.scene.checks import InvalidValueError
from clusterviz.scene.field_types import ERROR_HANDLERS, Section
from clusterviz.scene.values import Camera, Clip, Cluster, ImageSettings, Quality, Scene, Volume

KeyPath = tuple[str | int, ...]
SECTIONS: tuple[tuple[KeyPath, type[Section]], ...] = (
    (("volumes", 0), Volume),
    (("camera",), Camera),
    (("clip",), Clip),
    (("image",), ImageSettings),
    (("quality",), Quality),
    (("cluster",), Cluster),
)
KEY_PATHS: dict[str, KeyPath] = {name: (*key, name) for key, section in SECTIONS for name in section.model_fields}
"""Last name -> full path; no name occurs in two of these sections."""
MAX_LISTED = 8
"""Largest number of errors that a message lists; the rest are counted."""

TYPE_MESSAGES = {
    "float_type": ("not a number", "a number"),
    "int_type": ("not a whole number", "a whole number"),
    "int_from_float": ("not a whole number", "a whole number"),
    "string_type": ("not a text", "a text (in quotes where it looks like a number or a date)"),
    "bool_type": ("not a switch", "true, false"),
    "finite_number": ("not finite", "a finite number"),
}
LIST_MESSAGES = {
    "missing": "missing",
    "tuple_type": "not a list",
    "too_short": "too few values",
    "too_long": "too many values",
}
BOUND_MESSAGES = {
    "greater_than": ("too small", "more than", "gt"),
    "greater_than_equal": ("too small", "at least", "ge"),
    "less_than": ("too large", "less than", "lt"),
    "less_than_equal": ("too large", "at most", "le"),
}


def scene_error(
    error: ValidationError, where: str, options: Mapping[KeyPath, str] | None = None, root: type[BaseModel] = Scene
) -> SceneError:
    """Return a `SceneError` with one line for each error of a validation.

    `error`: pydantic's error; `where`: the scene file, or another name of the scene; `options`: key path -> text of the
    option that set it, which is named instead of the file; `root`: the validated section or message.
    """
    found = {str(_error_of(details, where, options or {}, root)): None for details in error.errors()}
    lines = list(found)[:MAX_LISTED]
    if len(found) > MAX_LISTED:
        lines.append(f"and {len(found) - MAX_LISTED} more errors")
    return SceneError("\n".join(lines))


ERROR_HANDLERS.append(scene_error)


def format_key(key: KeyPath) -> str:
    """Return a key path in the form volumes[0].clim, without the tags of unions."""
    text = ""
    for part in key:
        if isinstance(part, int):
            text += f"[{part}]"
        elif not part.startswith("<"):
            text += f".{part}" if text else part
    return text


def unknown_key(where: str, name: object, section: type[BaseModel] | None) -> SceneError:
    """Return the error for an unknown key, with the most similar known key."""
    known = list(section.model_fields) if section else []
    elsewhere = KEY_PATHS if section is Scene or any(section is other for _, other in SECTIONS) else {}
    word = str(name)
    tries = ((elsewhere, 1.0), (known, 0.7), (elsewhere, 0.7), (known, 0.5))
    near = next((found[0] for names, cutoff in tries if (found := get_close_matches(word, names, 1, cutoff))), None)
    hint = f", did you mean {near if near in known else format_key(elsewhere[near])}?" if near else ""
    return SceneError(f"unknown key{hint}", where=where, found=name, allowed=", ".join(known) or None)


def section_at(key: KeyPath, root: type[BaseModel] = Scene) -> type[BaseModel] | None:
    """Return the section at a key path, or None."""
    section = root
    for part in key:
        if isinstance(part, int) or part.startswith("<"):
            continue
        field = section.model_fields.get(part)
        inner = _section_in(field.annotation) if field else None
        if inner is None:
            return None
        section = inner
    return section


def format_value(value: Any) -> str:
    """Return a value as JSON on one line of at most 80 characters."""
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except (TypeError, ValueError):
        text = str(value)
    return text if len(text) <= 80 else text[:77] + "…"


def _section_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _section_in(part))), None)


def _error_of(details: ErrorDetails, where: str, options: Mapping[KeyPath, str], root: type[BaseModel]) -> SceneError:
    kind, key, context = details["type"], details["loc"], details.get("ctx", {})
    found: str | None = None if kind == "missing" else format_value(details["input"])
    cause = context.get("error")
    if isinstance(cause, InvalidValueError):
        if cause.key:  # the input is the whole section
            key, found = (*key, cause.key), None
        found = format_value(cause.found) if cause.found is not None else found
        return SceneError(cause.what, where=_location(key, where, options), found=found, allowed=cause.allowed)
    if kind == "missing" and isinstance(key[-1], int):  # an item of a list, which is the input
        kind, key, found = "too_short", key[:-1], format_value(details["input"])
    place = _location(key, where, options)
    if kind == "extra_forbidden":
        return unknown_key(place, key[-1], section_at(key[:-1], root))
    what, allowed = _describe(kind, key, details["msg"], context, root)
    return SceneError(what, where=place, found=found, allowed=allowed)


def _describe(
    kind: str, key: KeyPath, message: str, context: Mapping[str, Any], root: type[BaseModel]
) -> tuple[str, str | None]:
    """Return the problem and the values allowed for an error of pydantic's own."""
    if kind in TYPE_MESSAGES:
        return TYPE_MESSAGES[kind]
    if kind in BOUND_MESSAGES:
        what, relation, bound = BOUND_MESSAGES[kind]
        return what, f"{relation} {context[bound]:g}"
    if kind == "literal_error":
        return "not one of the choices", context["expected"].replace("'", "").replace(" or ", ", ")
    if kind == "too_long" and key == ("volumes",):
        return "too many volumes", f"at most {context['max_length']}"
    if kind in LIST_MESSAGES:
        example = _example(key, root)
        limit = f"at most {context['max_length']} values" if kind == "too_long" else "a list"
        limit = "a value" if kind == "missing" else limit
        return LIST_MESSAGES[kind], limit if example is None else f"{limit}, such as {format_value(example)}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        section = section_at(key, root)
        return "not a section", f"keys with values: {', '.join(section.model_fields) if section else ''}"
    return message[:1].lower() + message[1:], None


def _example(key: KeyPath, root: type[BaseModel]) -> Any:
    """Return an example value of a key or list item, from the examples of its field; None without examples."""
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
    """Return the examples in the annotation of a type or of one of its parts."""
    if isinstance(annotation, FieldInfo):
        return annotation.examples
    parts = sorted(get_args(annotation), key=lambda part: not isinstance(part, FieldInfo))
    return next((found for part in parts if (found := _examples_in(part))), None)


def _location(key: KeyPath, where: str, options: Mapping[KeyPath, str]) -> str:
    for end in range(len(key), 0, -1):
        if key[:end] in options:
            return f"{options[key[:end]]}: {format_key(key)}"
    return f"{where}: {format_key(key)}" if key else where
