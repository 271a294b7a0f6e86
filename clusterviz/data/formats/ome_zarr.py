"""OME-Zarr 0.4 and 0.5, and single Zarr arrays, on disk or at a URL: the finest level of a volume, brick by brick.

Stores that `clusterviz store` wrote are read without zarr-python, whose reading of a brick takes longer than decoding.
A store of others is read by it. There a chunk that is absent is not an error: it holds the fill value.

`array` names a level, or an image inside the store, such as `labels/NAME`, a series of bioformats2raw or a field of a
plate, and its level: `labels/NAME/1`. Axes of space are placed by their names, in any order; those with different units
are converted to that of x.

References
----------
OME-Zarr 0.5, ngff.openmicroscopy.org: multiscales, axes, coordinateTransformations, omero, labels, plate.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import takewhile
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import MAX_LISTED, Hyperslab, Subset, UnnamedPartError, select, unnamed_axes
from clusterviz.data.bricks import Box, BrickLayout
from clusterviz.data.files import library
from clusterviz.data.formats import ZARR
from clusterviz.data.header import METRES, check_box, check_dtype, make_grid, triple, unit_factors
from clusterviz.data.remote import FilePath, find_range
from clusterviz.data.source import Grid, Index, Source
from clusterviz.data.store.levels import coarser, is_within, read_statistics
from clusterviz.data.store.shards import ShardedArray, description_checksum, open_array, read_json, require_packages
from clusterviz.data.summary import VolumeSummary
from clusterviz.errors import DataError

MAX_IMAGES = 64  # of a store that are counted
VERSIONS = (1, 2)
"""Of stores of clusterviz that are read."""
DISAGREE = "the levels disagree with their metadata"


@dataclass(frozen=True)
class OmeroChannel:
    """How a channel is shown.

    Attributes
    ----------
    color : red, green and blue, 0 to 1; None if the file has none
    window : the values that are black, and in full colour; None if the file has none
    active : whether it is shown
    """

    label: str
    color: tuple[float, float, float] | None = None
    window: tuple[float, float] | None = None
    active: bool = True


@dataclass(frozen=True)
class LevelSource:
    """Level of a store that clusterviz wrote, with the coarser ones; see `MultilevelSource`.

    Attributes
    ----------
    paths : of the arrays of all levels of the store
    number : of this level in the store; coarser ones are its levels
    omero : how the channels are shown
    version : another one for each description of a store
    """

    name: str
    grid: Grid
    array: ShardedArray
    paths: tuple[FilePath, ...]
    slab: Hyperslab
    number: int
    brick: int
    omero: tuple[OmeroChannel, ...] = ()
    version: str = ""
    opened: dict[int, LevelSource] = field(default_factory=dict, compare=False, repr=False)

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.array.dtype

    @property
    def levels(self) -> int:
        return len(self.paths) - self.number

    def level(self, number: int) -> LevelSource:
        if number == 0:
            return self
        if number not in self.opened:
            path, grid = self.paths[self.number + number], self.grid.coarser(number)
            array = _own_array(path, self.array.check, self.array.has_checksums).at(*self.array.index)
            if (array.shape_zyx, array.dtype) != (grid.shape_zyx, self.dtype):
                raise DataError(DISAGREE, where=str(path), found=array.shape_zyx, allowed=grid.shape_zyx)
            name, at = f"{self.name}:/{path.name}", self.number + number
            self.opened[number] = replace(self, name=name, grid=grid, array=array, number=at, opened={})
        return self.opened[number]

    def bounds(self, number: int) -> NDArray[np.float64]:
        return self.level(number).array.statistics()

    def at_time(self, time: int) -> LevelSource:
        subset = Subset(time=time, channel=self.slab.channel)
        slab = select(self.slab.shape, f"{self.array.axes}zyx".upper(), subset, self.name, self.slab.channel_names)
        name = self.name.replace(f":time={self.slab.time}", f":time={time}")
        return replace(self, name=name, array=self.array.at_step(time), slab=slab, opened={})

    @cached_property
    def _steps(self) -> NDArray[np.int64]:
        return self.array.steps()

    def is_same(self, other: Source, begin_zyx: Index, end_zyx: Index) -> bool:
        """Return whether a box of samples is the same at another time step; see `SeriesSource`.

        Bricks that the store does not know to be the same are read, and their samples in the box are compared.
        """
        if not isinstance(other, LevelSource) or self.array.at_step(other.array.step) != other.array:
            return False
        first = [b // side for b, side in zip(begin_zyx, self.array.brick_zyx, strict=True)]
        last = [-(-e // side) for e, side in zip(end_zyx, self.array.brick_zyx, strict=True)]
        here = tuple(map(slice, first, last))
        for z, y, x in (np.argwhere(self._steps[here] != other._steps[here]) + first).tolist():
            low, high = self.array.box_of((z, y, x))
            lz, ly, lx = np.maximum(low, begin_zyx).tolist()
            hz, hy, hx = np.minimum(high, end_zyx).tolist()
            box = (lz, ly, lx), (hz, hy, hx)
            if not is_within(self.read(*box), other.read(*box), 0.0):
                return False
        return True

    def summary(self, layout: BrickLayout) -> VolumeSummary | None:
        """Return the summary that the store keeps of its finest level; None of another level."""
        if self.array.path != self.paths[0]:
            return None
        return read_statistics(self.array.summary_path, layout, self.array.has_checksums)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        return self.array.read(begin_zyx, end_zyx)

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]]:
        return self.array.read_boxes(boxes)


@dataclass(frozen=True)
class ZarrSource:
    """Volume in an array of zarr-python."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    array: Any
    slab: Hyperslab
    omero: tuple[OmeroChannel, ...] = ()
    version: str = ""

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        from clusterviz.data.store.zarr_files import read_array  # which may be missing

        return np.array(read_array(self.array, self.slab.box(begin_zyx, end_zyx)), self.dtype, order="C").reshape(shape)


def open_ome_zarr(path: FilePath, subset: Subset) -> LevelSource | ZarrSource:
    """Open the finest level of a store, or the level or image that `subset` names."""
    path, attributes, level = find_image(path, subset.array)
    where, own = str(path), attributes.get("clusterviz")
    if own and not own.get("complete"):
        raise DataError("half written", where=where, allowed="the same `clusterviz store` again, which continues it")
    scales = _multiscales(attributes) or {}
    datasets = scales.get("datasets") or [{"path": ""}]
    wanted = level or datasets[0]["path"]
    for each in datasets:
        check_below(each["path"], where)
    described: Mapping[str, Any] = next((each for each in datasets if each["path"] == wanted), {})
    place = path / wanted
    if own:
        require_packages(where)
        has_checksums = _check_description(attributes, where)
        array, shape = (
            _own_array(place, partial(_check_same, path / "zarr.json", attributes), has_checksums),
            tuple(own.get("shape", ())),
        )
        for _ in range(datasets.index(described) if described else 0):
            shape = coarser(shape)
        if (array.shape_zyx, array.dtype.name) != (shape, own.get("dtype")):
            raise DataError(DISAGREE, where=str(place), found=array.shape_zyx, allowed=shape)
        stored, omero = array.metadata["shape"], omero_channels(attributes)
        axes = _axes(scales, stored, (), where)
        letters, labels = f"{array.axes}zyx".upper(), [each.label for each in omero]
        slab = select(stored, letters, subset, where, labels)
        name, grid = _name(path, wanted, datasets, slab), _grid(slab, axes, scales, described, own, where)
        index, names = {"t": slab.time, "c": slab.channel}, [each["path"] for each in datasets]
        volume, paths = array.at(*(index[axis] for axis in array.axes)), tuple(path / each for each in names)
        return LevelSource(
            name, grid, volume, paths, slab, names.index(wanted), own["brick"], omero, _version(attributes)
        )
    opened = _open_by_zarr(path, wanted)
    axes = _axes(scales, opened.shape, getattr(opened.metadata, "dimension_names", None) or (), str(place))
    dtype = check_dtype(np.dtype(opened.dtype), where)
    omero = omero_channels(attributes)
    letters = "".join(axis.letter for axis in axes) if axes else unnamed_axes(opened.shape, subset)
    slab = select(opened.shape, letters, subset, where, [each.label for each in omero])
    grid = _grid(slab, axes, scales, described, {}, where)
    if "image-label" in (attributes.get("ome") or attributes):
        grid = replace(grid, modality="labels")
    return ZarrSource(
        _name(path, wanted, datasets, slab), grid, dtype, opened, slab, omero, _version(opened.metadata.to_dict())
    )


def find_image(path: FilePath, array: str | None) -> tuple[FilePath, dict[str, Any], str | None]:
    """Return the folder of an image, its attributes, and the part of `array` that names its level, if any does."""
    check_below(array or "", str(path))
    attributes, parts = _attributes(path), (array or "").split("/")
    if attributes is None:
        is_folder = isinstance(path, Path) and path.is_dir()
        what = "a directory without a store of Zarr" if is_folder else "not a store of Zarr"
        raise DataError(what, where=str(path), allowed=f"a folder with {' or '.join(ZARR)}")
    scales = _multiscales(attributes)
    if scales and (not array or any(each["path"] == array for each in scales["datasets"])):
        return path, attributes, array
    for count in range(len(parts), 0, -1) if array else ():
        inner = path.joinpath(*parts[:count])
        found = _attributes(inner)
        if found and _multiscales(found):
            return inner, found, "/".join(parts[count:]) or None
    group = attributes.get("ome", attributes)
    if array is None and "bioformats2raw.layout" in group:
        if _attributes(path / "1") is None:
            return find_image(path, "0")
        images = list(takewhile(lambda name: _attributes(path / name) is not None, map(str, range(MAX_IMAGES))))
        raise UnnamedPartError("array", images, where=str(path), allowed="array: 0, 1, …", noun="image")
    if array is None and "plate" in group:
        wells = ", ".join(f"{each['path']}/0" for each in group["plate"].get("wells", [])[:MAX_LISTED])
        raise DataError("a plate: name a field of a well", where=str(path), allowed=f"array: {wells}, …")
    return path, attributes, array


def check_below(name: object, where: str) -> None:
    """Check that the path of an array is one below the store, so that nothing else is read in its name."""
    plain = unquote(name).replace("\\", "/") if isinstance(name, str) else "/"
    if plain.startswith("/") or ".." in plain.split("/"):
        raise DataError("an array outside of the store", where=where, found=name, allowed="a path below it")


def _attributes(path: FilePath) -> dict[str, Any] | None:
    for name in ZARR:
        if find_range(path / name):
            found = read_json(path / name)
            attributes = found.get("attributes", {}) if name == "zarr.json" else found
            if not isinstance(attributes, dict):
                raise DataError("damaged", where=str(path / name), found=type(attributes).__name__, allowed="an object")
            return attributes
    return None


def _multiscales(attributes: Mapping[str, Any]) -> Any:
    return next((each for each in attributes.get("ome", attributes).get("multiscales") or () if each["datasets"]), None)


def omero_channels(attributes: Mapping[str, Any]) -> tuple[OmeroChannel, ...]:
    found = (attributes.get("ome", attributes).get("omero") or {}).get("channels") or []
    return tuple(_omero_channel(n, each) for n, each in enumerate(found))


def _omero_channel(number: int, found: Mapping[str, Any]) -> OmeroChannel:
    text, window = str(found.get("color", "")), found.get("window") or {}
    digits = re.fullmatch(r"#?([0-9a-fA-F]{6})(?:[0-9a-fA-F]{2})?", text)
    low, high = (window.get(key) for key in ("start", "end"))
    ends = None
    if isinstance(low, int | float) and isinstance(high, int | float) and -math.inf < low < high < math.inf:
        ends = (float(high), float(low)) if found.get("inverted") else (float(low), float(high))
    red, green, blue = (b / 255 for b in bytes.fromhex(digits[1])) if digits else (1.0, 1.0, 1.0)
    color = (red, green, blue) if digits else None
    label = str(found.get("label") or number)
    return OmeroChannel(label, color, ends, bool(found.get("active", True)))


def channel_sections(path: FilePath) -> list[dict[str, Any]]:
    """Return keys of a scene's volumes, one a channel that is shown if the file says how, else one without keys."""
    shown = [(n, each) for n, each in enumerate(omero_channels(find_image(path, None)[1])) if each.active]
    if len(shown) < 2 or not all(each.color and each.window for _, each in shown):
        return [{}]
    return [
        {"channel": n, "clim": sorted(each.window or ()), "cmap": [[end, *colour] for end, colour in _ramp(each)]}
        for n, each in shown
    ]


def _ramp(channel: OmeroChannel) -> list[tuple[float, tuple[float, ...]]]:
    assert channel.window
    assert channel.color
    return sorted(zip(channel.window, ((0.0, 0.0, 0.0), channel.color), strict=True))


def _version(description: Mapping[str, Any]) -> str:
    return hashlib.sha256(repr(description).encode()).hexdigest()


def _check_same(path: FilePath, attributes: Mapping[str, Any]) -> None:
    found = find_range(path, fresh=True)
    if found is None or json.loads(found[0]).get("attributes") != attributes:
        raise DataError("the store was changed while it was in use", where=str(path.parent), allowed="start again")


def _check_description(attributes: Mapping[str, Any], where: str) -> bool:
    """Check the description of a store of clusterviz; return whether its statistics have checksums."""
    own = attributes["clusterviz"]
    version, found = own.get("version"), own.get("checksum")
    if version not in VERSIONS:
        raise DataError("a store of another version", where=where, found=version, allowed=", ".join(map(str, VERSIONS)))
    if found is None:
        what = "its statistics and error bounds have" if version == 1 else "its description has"
        warnings.warn(
            f"{where}: {what} no checksum; `clusterviz store` writes it with one", FutureWarning, stacklevel=2
        )
    elif found != description_checksum(attributes):
        what = "the description of the store was changed since it was written: damaged, or edited"
        raise DataError(what, where=where, allowed="if it was edited, remove clusterviz.checksum in its zarr.json")
    return bool(version > 1)


def _own_array(path: FilePath, check: Callable[[], None], has_checksums: bool) -> ShardedArray:
    array = open_array(path, check, has_checksums)
    if array is None:
        raise DataError(DISAGREE, where=str(path))
    array.codec.require(str(path))
    return array


def _name(path: FilePath, wanted: str, datasets: Sequence[Any], slab: Hyperslab) -> str:
    return f"{path}{'' if wanted == datasets[0]['path'] else ':/' + wanted}{slab.label}"


def _open_by_zarr(path: FilePath, wanted: str) -> Any:
    library("zarr", "store", str(path))
    from clusterviz.data.store.zarr_files import open_zarr  # which may be missing

    place, kind, is_newer = path / wanted, "", False
    if find_range(place / "zarr.json"):
        is_newer = True
        kind = str(read_json(place / "zarr.json").get("node_type"))
    elif find_range(place / ".zarray"):
        kind = "array"
    if kind != "array":
        files = [file for name in ZARR for file in place.glob(f"*/{name}")] if isinstance(place, Path) else []
        held = ", ".join(sorted({file.parent.name for file in files})) or None
        what = "no array is named" if kind or held else "no such array"
        raise DataError(what, where=str(place), allowed=held)
    return open_zarr(place, 3 if is_newer else 2)


@dataclass(frozen=True)
class _Axis:
    """Axis of an array: its name, its letter for `select`, and its unit."""

    name: str
    letter: str
    unit: str = ""


def _axes(scales: Mapping[str, Any], shape: Sequence[int], names: Sequence[str | None], where: str) -> list[_Axis]:
    """Return the axes of an array, whose own names are `names`; none if they have no names."""
    axes: Sequence[Any] = scales.get("axes") or names
    if scales.get("axes") and len(axes) != len(shape):
        expected = [each if isinstance(each, str) else each.get("name") for each in axes]
        raise DataError(DISAGREE, where=where, found=f"shape {tuple(shape)}", allowed=f"axes {expected}")
    found = []
    for axis in axes:
        each = axis if isinstance(axis, dict) else {"name": axis or ""}
        name, kind = str(each.get("name", "")), each.get("type")
        is_time, is_channel = kind == "time" or name in ("t", "time"), kind == "channel" or name in ("c", "channel")
        letter = "T" if is_time else "C" if is_channel else "Z"
        found.append(_Axis(name, letter, str(each.get("unit") or "")))
    return found if any(axis.name for axis in found) else []


def _units(units: Sequence[str], world: Sequence[int], where: str) -> list[float]:
    """Return the factors to the unit of x, or of the next axis that has one; 1 for axes without a unit."""
    order = sorted(range(len(units)), key=lambda n: world[n])
    found = unit_factors([units[n] for n in order])
    if found is None:
        raise DataError("units that differ and are not known", where=where, found=units, allowed=", ".join(METRES))
    return [found[order.index(n)] for n in range(len(units))]


def _grid(
    slab: Hyperslab, axes: Sequence[_Axis], scales: Mapping[str, Any], level: Mapping[str, Any], own: Any, where: str
) -> Grid:
    """Return the grid of a level: its transforms, then those of all levels."""
    count = len(slab.shape)
    scale, shift = np.ones(count), np.zeros(count)
    for each in [*level.get("coordinateTransformations", ()), *scales.get("coordinateTransformations", ())]:
        if each.get("type") == "identity":
            continue
        numbers = np.asarray(each.get("scale", each.get("translation", ())), float)
        if each.get("type") not in ("scale", "translation") or numbers.shape != (count,):
            allowed = f"scale and translation of {count} numbers"
            raise DataError("a transform that is not read", where=where, found=each.get("type"), allowed=allowed)
        if each["type"] == "scale":
            scale, shift = scale * numbers, shift * numbers
        else:
            shift = shift + numbers
    kept = [axis for axis, index in enumerate(slab.index) if index is None][::-1]
    world = [*range(3)]  # axis of the world by axis of the volume, both x, y, z
    named = [axes[axis].name.lower() for axis in kept] if axes else []
    if named and len({*named} & {*"xyz"}) == len(kept):
        world = ["xyz".index(name) for name in named]
        world += [axis for axis in range(3) if axis not in world]
    units = _units([axes[axis].unit if axes else "" for axis in kept], world, where)
    placed, origin = np.eye(3)[:, world], np.zeros(3)
    for n, (axis, unit) in enumerate(zip(kept, units, strict=True)):
        placed[:, n] *= scale[axis] * unit
        origin[world[n]] = shift[axis] * unit
    direction = np.asarray(own.get("direction", np.eye(3)) if own else np.eye(3), float)
    if direction.shape != (3, 3):
        raise DataError("singular placement", where=where, found=direction.tolist(), allowed="3 × 3 numbers")
    grid = make_grid(slab.shape_zyx, direction @ placed, triple(origin, where), where)
    if own:
        return replace(grid, orientation=str(own.get("orientation", "")), modality=str(own.get("modality", "")))
    return replace(grid, modality="microscopy")
