"""Data in memory or in files that a caller of `clusterviz.render` or `clusterviz.view` gives: scene and sources."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clusterviz.data import open_scene
from clusterviz.data.geometry import Geometry, Lines, Points, as_geometry
from clusterviz.data.memory import ArraySource
from clusterviz.data.outside import has_scalars, outside_of
from clusterviz.data.source import Source
from clusterviz.data.vectors import VectorArray, VectorSource
from clusterviz.data.vtk_cells import as_grid, is_grid
from clusterviz.errors import DataError, InputError
from clusterviz.scene.field_types import Section
from clusterviz.scene.flows import FlowSection
from clusterviz.scene.geometry import GEOMETRY_SECTIONS, as_sections
from clusterviz.scene.grids import LISTED_SECTIONS, GridSection
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Scene, Volume


def given_scene(given: Any, grid: Any, settings: Mapping[str, Any], where: str) -> tuple[Scene, Any]:
    """Return the scene of a caller's arguments, and the data that are not in files.

    Parameters
    ----------
    given, grid, settings : as in `clusterviz.render`
    where : name of the function, for errors

    Returns
    -------
    scene : with the settings
    sources : the data of all volumes, or a list with those of each volume, entry of geometry, grid and flow, in which
        None is a file; None if all are files

    Raises
    ------
    SceneError, DataError, InputError
        An argument is no data, a file cannot be read, or a setting does not suit the scene.
    """
    scene, sources = _scene_and_sources(given, grid, where)
    named, in_memory = _named_objects(dict(settings))
    scene = with_settings(scene, named)
    if in_memory:
        sources = _joined_sources(scene, sources, in_memory)
    elif sources is not None and any(v.time is not None or v.channel is not None for v in scene.volumes):
        allowed = "array[time], array[..., channel]"
        raise InputError("only files have time steps and channels", where=where, allowed=allowed)
    return scene, sources


def _scene_and_sources(given: Any, grid: Any, where: str) -> tuple[Scene, Any]:
    if isinstance(given, (list, tuple)):
        return _several(given, grid, where)
    if is_grid(given):
        given = as_grid(given, where)
        given = given if has_scalars(given) else outside_of(given)
    if is_grid(given):
        return Scene(grids=(GridSection(path="array"),), automatic=True), [given]
    if _is_vectors(given):
        return Scene(flows=(FlowSection(path=given.name),), automatic=True), [given]
    if any(hasattr(given, name) for name in ("faces", "vertices")) or isinstance(given, (Geometry, Lines, Points)):
        # Objects of pyvista may have all, of which some are empty.
        cells = (("meshes", "faces"), ("lines", "lines"))
        kind = next((name for name, attribute in cells if len(getattr(given, attribute, ()))), "points")
        geometry = as_geometry(given, kind, where)
        parts = {"meshes": geometry.mesh, "lines": geometry.lines, "points": geometry.points}
        each = [section(path="array") for name, section in GEOMETRY_SECTIONS.items() if parts[name]]
        sections: dict[str, Any] = as_sections(each)
        return Scene(**sections, automatic=True), [geometry] * len(each)
    if hasattr(given, "__array__"):
        given, grid = ArraySource(np.asarray(given), grid), None
    if grid is not None:
        raise InputError("only an array takes a grid", where=where, found=f"a grid and {type(given).__name__}")
    if isinstance(given, Scene):
        return given, None
    if isinstance(given, (str, os.PathLike)):
        return open_scene(given), None
    if all(hasattr(given, name) for name in ("name", "grid", "dtype", "read")):
        return Scene(volumes=(Volume(path=given.name),), automatic=True), given
    raise InputError(f"nothing to {where}", where=where, found=type(given).__name__, allowed="a scene, path or array")


def _several(given: Sequence[Any], grids: Any, where: str) -> tuple[Scene, list[Source]]:
    """Return the scene of several arrays and data sources, and the sources."""
    each = [None] * len(given) if grids is None else list(grids)
    if len(each) != len(given):
        raise InputError("not one for each volume", where=f"{where}: grid", found=len(each), allowed=len(given))
    parts = [_scene_and_sources(data, grid, where) for data, grid in zip(given, each, strict=True)]
    sources: list[Any] = [source for _, source in parts]
    if not parts or any(source is None or isinstance(source, list) for source in sources):
        allowed = "arrays, or objects with name, grid, dtype and read; files go into a scene"
        raise InputError("not data", where=where, found="a list of other things", allowed=allowed)
    return Scene(volumes=tuple(volume for scene, _ in parts for volume in scene.volumes), automatic=True), sources


def _named_objects(settings: dict[str, Any]) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Return settings with a name in place of each object of meshes, lines, points, grids and flows, and these."""
    found: dict[str, list[Any]] = {}
    for name in LISTED_SECTIONS.keys() & settings.keys():
        items, sections = settings[name], []
        is_one = not isinstance(items, (list, tuple)) or (name in ("meshes", "grids") and isinstance(items, tuple))
        found[name] = []
        for number, item in enumerate([items] if is_one else items):
            section: Any = item if isinstance(item, (dict, Section)) else {"path": item}
            given = section.get("path") if isinstance(section, dict) else None
            if given is None or isinstance(given, (str, os.PathLike)):
                found[name].append(None)
            else:
                key = f"{name}[{number}]"
                found[name].append(_object(given, name, key))
                section = {**section, "path": "array"}
            sections.append(section)
        settings[name] = sections
    return settings, found


def _object(given: Any, section: str, key: str) -> Any:
    """Return an object in memory in the form of its section's entries."""
    if section == "grids":
        return as_grid(given, key)
    return as_vectors(given, key) if section == "flows" else as_geometry(given, section, key)


def _is_vectors(given: Any) -> bool:
    return all(hasattr(given, name) for name in ("name", "grid", "times", "read", "at_time"))


def as_vectors(given: Any, where: str) -> VectorSource:
    """Return vectors in memory: a `VectorSource` as it is, or an array (z, y, x, 3).

    Raises
    ------
    DataError
        It is neither.
    """
    if _is_vectors(given):
        vectors: VectorSource = given
        return vectors
    if not hasattr(given, "__array__"):
        allowed = "an array (z, y, x, 3), VectorArray"
        raise DataError("not vectors", where=where, found=type(given).__name__, allowed=allowed)
    return VectorArray(np.asarray(given), name=where)


def _joined_sources(scene: Scene, source: Any, in_memory: dict[str, list[Any]]) -> list[Any]:
    """Return what is given for each volume, entry of geometry, grid and flow of a scene; None: the file is read."""
    given = list(source) if isinstance(source, list) else [source] * len(scene.volumes)
    joined, rest = given[: len(scene.volumes)], given[len(scene.volumes) :]
    for name in LISTED_SECTIONS:
        count = len(getattr(scene, name))
        if name in in_memory:
            joined += in_memory[name]
        else:  # as the scene was given: in memory, or files
            joined += rest[:1] * count if rest else [None] * count
    return joined
