"""Scene files: reading YAML or JSON, writing YAML, and the JSON Schema."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from clusterviz.content.sections import CONTENT_SECTIONS
from clusterviz.content.volume.presets import PRESET_DEFAULTS
from clusterviz.errors import SceneError, guard, public_address
from clusterviz.scene.colormaps import colour_points
from clusterviz.scene.overrides import apply_overrides, parse_overrides
from clusterviz.scene.transfer_2d import read_table
from clusterviz.scene.validation_messages import KeyPath, format_value, scene_error
from clusterviz.scene.values import Scene
from clusterviz.scene.yaml_text import parse_yaml, read_text, write_yaml, yaml_problem

SUFFIXES = (".yaml", ".yml", ".json")
"""File name suffixes of scene files; all other files are data files."""


def load_scene(path: str | os.PathLike[str], overrides: Sequence[str] = (), preset: str | None = None) -> Scene:
    """Read a scene from a YAML or JSON file.

    Returns it with absolute paths; paths in the file and in overrides are relative to the file's folder. Raises
    SceneError: the file cannot be read, or holds an unknown key or an invalid value.

    `path`: the file; JSON if the suffix is .json. `overrides`: options such as "quality.step=0.25", see
    `parse_overrides`. `preset`: of all volumes, in place of the keys in the file that presets choose.
    """
    where = os.fspath(path)
    parsed = parse_overrides(overrides)
    with guard(SceneError, where):
        data = _sections(_parse(read_text(where, SceneError), where), where)
        by_preset = _apply_preset(data, preset, PRESET_DEFAULTS)
        data, options = apply_overrides(data, parsed)
        return check_scene(_absolute(data, Path(where).absolute().parent), where, by_preset | options)


def scene_of_data(
    path: str | os.PathLike[str],
    overrides: Sequence[str] = (),
    sections: Sequence[str] = ("volumes",),
    keys: Sequence[Mapping[str, Any]] = ({},),
    preset: str | None = None,
) -> Scene:
    """Return a scene with automatic settings for one data file.

    `sections`: what the file holds: volumes, meshes, lines, points, grids. `keys`: of each entry of a section.
    `preset`: of all volumes; the default is chosen by the class of their values.
    """
    where = os.fspath(path)
    found: dict[str, Any] = {name: [{"path": where, **each} for each in keys] for name in sections}
    by_preset = _apply_preset(found, preset)
    data, options = apply_overrides({**found, "automatic": True}, parse_overrides(overrides))
    return check_scene(_absolute(data, Path.cwd()), where, by_preset | options)


def _apply_preset(data: dict[str, Any], preset: str | None, replaced: Iterable[str] = ()) -> dict[KeyPath, str]:
    """Set the preset of all volumes in raw scene data, and remove other keys; return the keys set, with the option."""
    if preset is None:
        return {}
    option, volumes = f"--preset {preset}", data.get("volumes")
    if not isinstance(volumes, list) or not volumes:
        raise SceneError("no volume that could have a preset", where=option, allowed="a scene with volumes")
    for volume in (each for each in volumes if isinstance(each, dict)):
        for key in replaced:
            volume.pop(key, None)
        volume["preset"] = preset
    return {("volumes", number, "preset"): option for number in range(len(volumes))}


def load_picture_scene(path: str | os.PathLike[str], text: str, overrides: Sequence[str] = ()) -> Scene:
    """Return the scene that a picture holds.

    `path`: the picture; paths in its scene are relative to its folder. `text`: the scene in the picture, YAML.
    `overrides`: as of `load_scene`; their paths are relative to the working folder. Raises SceneError: the scene is
    damaged, of another version of clusterviz, or an override is not valid.
    """
    where = f"{os.fspath(path)}: scene"
    with guard(SceneError, where):
        data = _absolute(_sections(_parse(text, where), where), Path(path).absolute().parent)
        data, options = apply_overrides(data, parse_overrides(overrides))
        return check_scene(_absolute(data, Path.cwd()), where, options)


def dump_scene(scene: Scene) -> str:
    """Return a scene as YAML with all keys, including defaults; `load_scene` reads it back as an equal scene.

    The secrets of addresses are left out, see `public_data`.
    """
    return write_yaml(public_data(scene))


def public_data(scene: Scene, exclude: AbstractSet[str] = frozenset()) -> dict[str, Any]:
    """Return a scene as JSON values that are kept or shown, without the secrets of addresses.

    `exclude`: sections that are left out.
    """
    return change_paths(scene.model_dump(mode="json", exclude=set(exclude)), public_address)


def scene_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of scene files."""
    schema = Scene.model_json_schema()
    for section in (schema, *schema["$defs"].values()):
        # The rest of a section's docstring repeats the descriptions of its keys.
        section["description"] = section["description"].partition("\n")[0]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "clusterviz scene"}


def _parse(text: str, where: str) -> Any:
    try:
        if where.lower().endswith(".json"):
            return json.loads(text, object_pairs_hook=_no_key_twice)
        return parse_yaml(text)
    except yaml.YAMLError as error:
        raise SceneError(f"not YAML: {yaml_problem(error)}", where=where) from None
    except json.JSONDecodeError as error:
        problem = f"not JSON: {error.msg} (line {error.lineno}, column {error.colno})"
        raise SceneError(problem, where=where) from None
    except ValueError as error:
        raise SceneError(str(error), where=where) from None


def _no_key_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {twice!r} occurs twice")
    return data


def _sections(data: Any, where: str) -> dict[str, Any]:
    allowed = f"the sections {', '.join(Scene.model_fields)}; a scene with nothing in it is volumes: []"
    if data is None:
        raise SceneError("the scene file is empty", where=where, allowed=allowed)
    if not isinstance(data, dict):
        raise SceneError("not a scene", where=where, found=format_value(data), allowed=allowed)
    return {key: value for key, value in data.items() if value is not None or key not in Scene.model_fields}


def _absolute(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return raw scene data with paths joined to a folder; addresses stay."""

    def joined(text: str) -> str:
        return text if "://" in text else os.path.normpath(folder / Path(text).expanduser())

    return change_paths(data, joined)


def data_paths(scene: Scene) -> dict[str, str]:
    """Return the path of each volume, entry of geometry and grid by its key, such as volumes.0.path."""
    return {
        f"{name}.{number}.path": entry.path
        for name in CONTENT_SECTIONS
        for number, entry in enumerate(getattr(scene, name))
    }


def change_paths(data: dict[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Return raw scene data with other paths and addresses of files; values of other types are left to validation."""
    lists = [data.get(name) for name in CONTENT_SECTIONS]
    for entry in (entry for entries in lists if isinstance(entries, list) for entry in entries):
        if not isinstance(entry, dict):
            continue
        table = entry.get("transfer_2d")
        for section, key in ((entry, "path"), (entry, "cmap"), (entry, "shader"), (table, "path")):
            text = section.get(key) if isinstance(section, dict) else None
            if isinstance(section, dict) and isinstance(text, str) and _is_path(key, text):
                section[key] = change(text)
    return data


def _is_path(key: str, text: str) -> bool:
    """Return whether the value of a key is a path or an address; field:NAME and names of colour maps are not."""
    if key == "cmap":
        return text.lower().endswith(".json")
    return bool(text.strip()) and not text.startswith("field:")


def check_scene(data: dict[str, Any], where: str, options: Mapping[KeyPath, str]) -> Scene:
    """Return the scene of raw data, whose colour maps and tables are there.

    `where`: the scene file, or another name of the scene; `options`: key path -> text of the option that set it. Raises
    SceneError: a key is unknown, or a value invalid.
    """
    try:
        scene = Scene.model_validate(data)
    except ValidationError as error:
        raise scene_error(error, where, options) from None
    for name in CONTENT_SECTIONS:
        for index, entry in enumerate(getattr(scene, name)):
            if isinstance(entry.cmap, str):
                place = options.get((name, index, "cmap"), where)
                colour_points(entry.cmap, (0.0, 1.0), where=f"{place}: {name}[{index}].cmap")
            if (table := getattr(entry, "transfer_2d", None)) is not None:
                place = options.get((name, index, "transfer_2d", "path"), where)
                read_table(table.path, where=f"{place}: {name}[{index}].transfer_2d.path")
    return scene
