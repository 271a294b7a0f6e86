"""Volume data: files, formulas and arrays behind one contract, bricks, and summaries; geometry, unstructured grids.

Every volume is a `Source`: it knows its `Grid` and reads any box of samples. Bricks divide a volume; summaries hold its
extremes, histogram and exact percentiles. Meshes, lines and points are read whole, as a `Geometry`; unstructured grids
by pieces, each as an `UnstructuredGrid`. Here are the functions that open files, by the registry in `formats/`.

All functions of this package raise `DataError` for what is missing, damaged, impossible, not supported or not unique in
data. Their docstrings do not repeat it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.data.axes import Choice, Subset, first_parts
from clusterviz.data.derived import GridOverride, GuardedSource, with_thickness
from clusterviz.data.field import open_field
from clusterviz.data.files import check_free_memory, require_file, unknown_file
from clusterviz.data.formats import (
    EXTENSIONS,
    FOLDER,
    GRID_EXTENSIONS,
    GRID_FORMATS,
    MESH_EXTENSIONS,
    Format,
    by_extension,
    format_of,
    function_of,
    grid_format_of,
    has_metadata,
    mesh_format_of,
)
from clusterviz.data.geometry import Geometry
from clusterviz.data.grid_files import SERIES, GridFile, grid_files
from clusterviz.data.header import make_grid
from clusterviz.data.labels import as_labels
from clusterviz.data.remote import is_url, remote_path
from clusterviz.data.scattered import open_scattered
from clusterviz.data.series import check_same, files_of_pattern, open_step
from clusterviz.data.source import Source
from clusterviz.data.tetrahedra import has_scalars, outside_of
from clusterviz.data.unstructured import UnstructuredGrid, check_volume, joined_grids
from clusterviz.errors import DataError, guard
from clusterviz.input_files import require_regular_file
from clusterviz.scene.files import SUFFIXES, load_scene, scene_of_data
from clusterviz.scene.values import Scene, Volume

OWN_PART = re.compile(r"(volumes\W0\W{1,2})?(array|channel)=")
"""Override that names a part of a file."""
ONE_STEP, ALL_STEPS = "a picture shows one time step", "time: its number, from 0; `animate` shows all"
FILE_AND_DATASET = re.compile(r"(.+\.(?:h5|hdf5|he5|nc|nc4)):(/.*)", re.IGNORECASE | re.DOTALL)


def open_source(path: str | Path, array: str | None = None, subset: Subset | None = None) -> Source:
    """Open a volume by name; only the header is read.

    Parameters
    ----------
    path : a file of a format in `FORMATS`, a folder of slices, `file.h5:/path/to/dataset`, `field:NAME[:SIZE]`, or a
        URL of OME-Zarr, or a pattern of names of files, which are time steps
    array : name of the array, for files with several; short for `Subset(array=array)`

    Raises
    ------
    DataError
        Missing, unreadable, damaged, of an unknown extension, or no such array, time step or channel.
    """
    with guard(DataError, path):
        return GuardedSource(_open(str(path), subset or Subset(array)))


def _open(text: str, part: Subset) -> Source:
    if text.startswith("field:"):
        return open_field(text)
    if is_url(text):
        return EXTENSIONS[".zarr"].open(remote_path(text), part)
    dataset = FILE_AND_DATASET.fullmatch(text)
    if dataset and not Path(text).exists():
        if part.array not in (None, dataset[2]):
            raise DataError("two arrays are named", where=text, found=part.array, allowed="one of them")
        text, part = dataset[1], replace(part, array=dataset[2])
    file = Path(text)
    found = format_of(file)
    if file.is_dir():
        is_zarr = (found and found.name == "ome-zarr") or has_metadata(file)
        return (EXTENSIONS[".zarr"] if is_zarr else FOLDER).open(file, part)
    files = files_of_pattern(text)
    if files != [text]:
        return open_step(files, part, _open, text)
    if part.scattered is not None:
        return open_scattered(file, part, read_grid(file) if grid_format_of(file) else read_geometry(file))
    if found is not None:
        require_file(file, found.magic)
        return found.open(file, part)
    raise unknown_file(file, EXTENSIONS, "; files of points with the key scattered")


def read_geometry(path: str | Path) -> Geometry:
    """Read the meshes, lines and points of a file of a format in `MESH_FORMATS`, or the outside of a grid's file.

    Raises
    ------
    DataError
        Missing, unreadable, damaged, of an unknown extension, or indices out of range.
    """
    file = Path(path)
    found = mesh_format_of(file)
    if found is None and grid_format_of(file):
        with guard(DataError, path):
            return outside_of(_whole_grid(file))
    found = found or by_extension(file, MESH_EXTENSIONS)
    if found is None:
        raise unknown_file(file, MESH_EXTENSIONS)
    with guard(DataError, path):
        check_free_memory(file, require_file(file, found.magic))
        geometry: Geometry = function_of(found.opener)(file)
        return geometry


def read_grid(path: str | Path, time: float | None = None) -> UnstructuredGrid:
    """Read an unstructured grid, whose pieces are joined.

    Parameters
    ----------
    path : a file of a format in `GRID_FORMATS`, a list of files, or a pattern of names; see `grid_files`
    time : number of a time step (int), or its time (float); None: the last one

    Raises
    ------
    DataError
        Missing, unreadable, damaged, of an unknown extension, no such time step, or as of `UnstructuredGrid`.
    """
    with guard(DataError, path):
        whole = _whole_grid(Path(path), time)
        check_volume(whole)
        return whole


def _whole_grid(path: Path, time: float | None = None) -> UnstructuredGrid:
    grids = [read_piece(file) for file in grid_files(path, time)]
    return grids[0] if len(grids) == 1 else joined_grids(grids, str(path))


_peeked: dict[tuple[GridFile, int], UnstructuredGrid] = {}
"""The file that `_sections_of_grid` has read, until it is read for the picture, so that it is read once."""


def _sections_of_grid(path: Path) -> tuple[str, ...]:
    """Return the section of a scene for a grid: meshes for surfaces, and for the outside of grids without scalars.

    The first piece with cells tells.
    """
    with suppress(DataError):  # the reader says it
        for file in grid_files(path):
            grid = read_piece(file)
            _peeked.clear()
            _peeked[file, _changed(file.path)] = grid
            if has_scalars(grid):
                break
            if grid.count or grid.surface:
                return ("meshes",)
            if grid.ignored:
                return ("points",)
    return ("grids",)


def _changed(path: Path) -> int:
    return path.stat().st_mtime_ns if path.exists() else 0


def read_piece(file: GridFile) -> UnstructuredGrid:
    """Read one of the files that `grid_files` returns; raises as `read_grid`."""
    if (known := _peeked.pop((file, _changed(file.path)), None)) is not None:
        return known
    path, time, found = file.path, file.time, by_extension(file.path, GRID_EXTENSIONS)
    with guard(DataError, path):
        if found is None or found.name == "list":
            raise unknown_file(path, GRID_EXTENSIONS)
        require_regular_file(path, DataError)
        if found.magic:
            check_free_memory(path, require_file(path, found.magic))
        if time is not None and not found.has_steps:
            allowed = (
                f"a file of {', '.join(each.name for each in GRID_FORMATS if each.has_steps)}, {' or '.join(SERIES)}"
            )
            raise DataError("no time steps", where=str(path), found=time, allowed=allowed)
        grid: UnstructuredGrid = function_of(found.opener)(path, *([time] if time is not None else []))
        return grid


def open_scene(path: str | PathLike[str], overrides: Sequence[str] = (), preset: str | None = None) -> Scene:
    """Return the scene of a scene file, or a scene for a data file, depending on the suffix.

    Channels of OME-Zarr with known colours and windows are a volume each; then the override `time=N` is for all.

    Raises
    ------
    SceneError, DataError
        The file cannot be read, or an override does not suit it.
    """
    if Path(path).suffix.lower() in SUFFIXES:
        return load_scene(path, overrides, preset)
    if is_url(str(path)) or Path(path).is_dir():
        return _scene_of_channels(str(path), overrides, preset)
    if grid_format_of(Path(path)):
        sections = _sections_of_grid(Path(path))
        if sections != ("grids",):  # geometry names its array scalars
            overrides = [
                each.replace("array=", "scalars=", 1) if each.startswith("array=") else each for each in overrides
            ]
        return scene_of_data(path, overrides, sections, preset=preset)
    found = mesh_format_of(Path(path))
    sections = _sections_of(Path(path), found) if found else ("volumes",)
    if not found and holds_only_vectors(str(path), overrides):
        sections = ("flows",)
    return scene_of_data(path, overrides, sections, preset=preset)


def holds_only_vectors(path: str, overrides: Sequence[str] = ()) -> bool:
    """Return whether what a file shows first is an array of vectors on a regular grid, not a volume of scalars.

    Parameters
    ----------
    overrides : of the scene, such as array=U
    """
    chosen = dict(each.partition("=")[::2] for each in overrides)
    if {"time", "channel"} & chosen.keys():
        return False
    subset, scalars = Subset(chosen.get("array"), spaced="spacing" in chosen), None
    with suppress(DataError):
        scalars, _, choices = first_parts(lambda part: open_source(path, subset=part), subset)
        if not choices:
            return False
    with suppress(DataError):
        vectors, _, _ = first_parts(
            lambda part: open_source(path, subset=part), replace(subset, channel=0, vectors=True)
        )
        slab, other = getattr(vectors, "slab", None), getattr(scalars, "slab", None)
        if slab is None or slab.channels != 3 or vectors.dtype.kind != "f" or vectors.grid.modality == "microscopy":
            return False
        # Axes without names may be time steps or channels of scalars, or components of vectors.
        return scalars is None or (other is not None and other.samples == slab.samples)
    return False


def _scene_of_channels(path: str, overrides: Sequence[str], preset: str | None) -> Scene:
    place, sections = remote_path(path) if is_url(path) else Path(path), list[dict[str, Any]]([{}])
    if has_metadata(place) and not any(OWN_PART.match(each) for each in overrides):
        with guard(DataError, path):
            sections = function_of("ome_zarr.channel_sections")(place)
    several = range(len(sections)) if len(sections) > 1 else ()
    each = [f"volumes.{n}.{override}" for override in overrides if override.startswith("time=") for n in several]
    kept = [override for override in overrides if not (several and override.startswith("time="))]
    return scene_of_data(path, [*each, *kept], keys=sections, preset=preset)


def _sections_of(path: Path, found: Format) -> tuple[str, ...]:
    """Return the sections of a scene for a file's geometry; the file is read if its format does not tell."""
    if found.section:
        return (found.section,)
    geometry = read_geometry(path)
    parts = {"meshes": geometry.mesh, "lines": geometry.lines, "points": geometry.points}
    return tuple(name for name, part in parts.items() if part) or ("meshes",)


def open_volume(volume: Volume) -> Source:
    """Open the data of a scene's volume, with the scene's grid; raises as `open_first_parts`."""
    return open_first_parts(volume)[0]


def open_first_parts(volume: Volume) -> tuple[Source, list[Choice]]:
    """Open a scene's volume, with the scene's grid: the first array, time step and channel that it does not name.

    Returns
    -------
    choices : that were made
    """
    if volume.time == "all":
        raise DataError(ONE_STEP, where=volume.path, found="time: all", allowed=ALL_STEPS)
    is_spaced = volume.spacing is not None
    subset = Subset(volume.array, volume.time, volume.channel, spaced=is_spaced, scattered=volume.scattered)
    source, _, choices = first_parts(lambda part: open_source(volume.path, subset=part), subset)
    return override_grid(source, volume), choices


def open_time_step(source: Source, volume: Volume) -> Source:
    known = getattr(source, "at_time", lambda time: None)(volume.time) if isinstance(volume.time, int) else None
    found: Source = known if known is not None else open_volume(volume)
    check_same(source, found)
    return found


def override_grid(source: Source, volume: Volume) -> Source:
    """Return the source with spacing, origin, direction and labels of the scene's volume, as far as it has them.

    A slice, or another source with one sample along an axis, gets a thickness, see `ThickSource`.
    """
    source = as_labels(source, volume.labels)
    if volume.spacing is None and volume.origin is None and volume.direction is None:
        return with_thickness(source)
    grid = source.grid
    axes = np.array(volume.direction or grid.direction)
    steps = axes / np.linalg.norm(axes, axis=0) * np.array(volume.spacing or grid.spacing)
    moved = make_grid(grid.shape_zyx, steps, volume.origin or grid.origin, source.name)
    placed = replace(moved, orientation="" if volume.direction else grid.orientation)
    return with_thickness(GridOverride(source, placed))
