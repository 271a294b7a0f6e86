"""Data in memory or in files that a caller of `clusterviz.render` or `clusterviz.view` gives: scene and sources."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence, Set
from contextlib import suppress
from typing import Any

import numpy as np

from clusterviz.content.flow.section import FlowSection
from clusterviz.content.geometry.section import GEOMETRY_SECTIONS, as_sections
from clusterviz.content.grid.section import GridSection
from clusterviz.content.sections import CONTENT_SECTIONS, LISTED_SECTIONS
from clusterviz.data import open_scene
from clusterviz.data.axes import Choice, Subset, first_parts, warn_of_choices
from clusterviz.data.geometry import Geometry, Lines, Points, as_geometry
from clusterviz.data.memory import ArraySource
from clusterviz.data.objects import open_object
from clusterviz.data.tetrahedra import has_scalars, outside_of
from clusterviz.data.vectors import VectorArray, VectorSource
from clusterviz.data.vtk_cells import as_grid, is_grid
from clusterviz.errors import DataError, InputError
from clusterviz.scene.field_types import Section
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Scene, Volume

CONTENT = CONTENT_SECTIONS.keys()
"""Sections of a scene that hold content."""


def given_scene(
    given: Any, grid: Any, settings: Mapping[str, Any], where: str, *, warns: bool = True
) -> tuple[Scene, Any]:
    """Return the scene of a caller's arguments, and the data that are not in files.

    Parameters
    ----------
    given, grid, settings : as in `clusterviz.render`
    where : name of the function, for errors
    warns : whether to say which parts of objects are drawn, on one of the ranks

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
    named: dict[str, Any] = {key: settings.get(key) for key in ("array", "time", "channel")}
    subset = Subset(**named, spaced="spacing" in settings)
    scene, sources, choices = _scene_and_sources(given, grid, where, subset, CONTENT & settings.keys())
    if warns:
        warn_of_choices(where, choices, option="")
    named, in_memory = _named_objects(dict(settings))
    scene = with_settings(scene, named)
    each = sources if isinstance(sources, list) else [sources] * (sources is not None)
    volumes: Any = _entries(scene)["volumes"]
    if any(v.time is not None or v.channel is not None for v in volumes) and any(map(_is_whole, each)):
        allowed = "array[time], array[..., channel]"
        raise InputError("only files have time steps and channels", where=where, allowed=allowed)
    return scene, _joined_sources(scene, sources, in_memory) if in_memory else sources


def _is_whole(source: Any) -> bool:
    """Return whether a source is no part of something, but data as they were given."""
    return source is not None and getattr(source, "slab", None) is None


def _scene_and_sources(
    given: Any, grid: Any, where: str, subset: Subset, content: Set[str] = frozenset()
) -> tuple[Scene, Any, list[Choice]]:
    """Return the scene of a first argument, its data in memory, and the choices among their parts.

    A subset names the part of an object of another library; sections of `content` among the settings may stand alone.
    """
    if given is None and content:
        return Scene(automatic=True), None, []
    if _is_indexed(given, 3):
        given = as_grid(given, where)
    elif _is_indexed(given, 2):
        given = as_geometry(given, "meshes", where)
    if isinstance(given, (list, tuple)):
        return _several(given, grid, where, subset)
    volume, _, choices = first_parts(lambda part: open_object(given, part, "array"), subset)
    return *_one(given if volume is None else volume, grid, where), choices


def _one(given: Any, grid: Any, where: str) -> tuple[Scene, Any]:
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
        kind = next((name for name, attribute in cells if _count(given, attribute)), "points")
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


def _count(given: Any, attribute: str) -> int:
    found = getattr(given, attribute, None)
    return 0 if found is None else len(found)


def _is_indexed(given: Any, count: int) -> bool:
    """Return whether a tuple is positions (n, 3), cells as integers and maybe scalars, not volumes."""
    if not isinstance(given, tuple) or len(given) != count:
        return False
    with suppress(ValueError):  # of lists of unequal lengths
        positions, cells = np.asarray(given[0]), np.asarray(given[1])
        return positions.shape[1:] == (3,) and cells.ndim in (1, 2) and cells.dtype.kind in "iu"
    return False


def _several(given: Sequence[Any], grids: Any, where: str, subset: Subset) -> tuple[Scene, Any, list[Choice]]:
    each = [None] * len(given) if grids is None else list(grids)
    if len(each) != len(given):
        raise InputError("not one for each volume", where=f"{where}: grid", found=len(each), allowed=len(given))
    subsets = [subset, *[Subset()] * (len(given) - 1)]
    triples = zip(given, each, subsets, strict=True)
    parts = [_scene_and_sources(data, grid, where, part) for data, grid, part in triples]
    sources: list[Any] = [source for _, source, _ in parts]
    if not parts or any(source is None or isinstance(source, list) for source in sources):
        allowed = "arrays, or objects with name, grid, dtype and read; files go into a scene"
        raise InputError("not data", where=where, found="a list of other things", allowed=allowed)
    volumes = tuple(Volume(path=source.name) for source in sources)
    return Scene(volumes=volumes, automatic=True), sources, [each for _, _, choices in parts for each in choices]


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
    if section == "grids":
        return as_grid(given, key)
    return as_vectors(given, key) if section == "flows" else as_geometry(given, section, key)


def _is_vectors(given: Any) -> bool:
    return all(hasattr(given, name) for name in ("name", "grid", "times", "read", "at_time"))


def as_vectors(given: Any, where: str) -> VectorSource:
    """Return vectors in memory: a `VectorSource` as it is, or an array (z, y, x, 3)."""
    if _is_vectors(given):
        vectors: VectorSource = given
        return vectors
    if not hasattr(given, "__array__"):
        allowed = "an array (z, y, x, 3), VectorArray"
        raise DataError("not vectors", where=where, found=type(given).__name__, allowed=allowed)
    return VectorArray(np.asarray(given), name=where)


def _joined_sources(scene: Scene, source: Any, in_memory: dict[str, list[Any]]) -> list[Any]:
    """Return what is given for each volume, entry of geometry, grid and flow of a scene; None: the file is read."""
    counts, joined = {name: len(entries) for name, entries in _entries(scene).items()}, list[Any]()
    given = list(source) if isinstance(source, list) else [source] * counts["volumes"]
    for name, count in counts.items():
        if name in in_memory:
            joined += in_memory[name]
        else:  # as the scene was given: in memory, or files
            joined += [*given[:count], *[None] * count][:count]
            del given[:count]
    return joined


def _entries(scene: Scene) -> dict[str, tuple[Section, ...]]:
    return {name: getattr(scene, name) for name in CONTENT_SECTIONS}
