"""OME-Zarr 0.4 and 0.5, and single Zarr arrays: the finest level of a volume, brick by brick.

Stores that `clusterviz store` wrote are read without zarr-python, whose reading of a brick takes longer than decoding.
A store of others is read by it. There a chunk that is absent is not an error: it holds the fill value.

References
----------
OME-Zarr 0.5, ngff.openmicroscopy.org: multiscales, axes, coordinateTransformations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, select, unnamed_axes
from clusterviz.data.bricks import Box, BrickLayout
from clusterviz.data.files import readable
from clusterviz.data.header import check_box, check_dtype, make_grid, triple
from clusterviz.data.source import Grid, Index
from clusterviz.data.store.levels import coarser
from clusterviz.data.store.shards import PACKAGES, ShardedArray, open_array, read_json, require_packages
from clusterviz.data.store.statistics import read_statistics
from clusterviz.data.summary import VolumeSummary
from clusterviz.errors import DataError

METADATA = ("zarr.json", ".zattrs", ".zgroup", ".zarray")
"""Files, one of which each folder of Zarr holds."""
DISAGREE = "the levels disagree with their metadata"


@dataclass(frozen=True)
class LevelSource:
    """Level of a store that clusterviz wrote, with the coarser ones; see `MultilevelSource`.

    Attributes
    ----------
    paths : of the arrays of all levels of the store
    number : of this level in the store; coarser ones are its levels
    brick : samples along the side of a brick
    """

    name: str
    grid: Grid
    array: ShardedArray
    paths: tuple[Path, ...]
    slab: Hyperslab
    number: int
    brick: int
    opened: dict[int, LevelSource] = field(default_factory=dict, compare=False, repr=False)

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.array.dtype

    @property
    def levels(self) -> int:
        """Number of levels."""
        return len(self.paths) - self.number

    def level(self, number: int) -> LevelSource:
        """Return a level; see `MultilevelSource`."""
        if number == 0:
            return self
        if number not in self.opened:
            path, grid = self.paths[self.number + number], self.grid.coarser(number)
            array = _own_array(path).at(*self.array.index)
            if (array.shape_zyx, array.dtype) != (grid.shape_zyx, self.dtype):
                raise DataError(DISAGREE, where=str(path), found=array.shape_zyx, allowed=grid.shape_zyx)
            name, at = f"{self.name}:/{path.name}", self.number + number
            self.opened[number] = replace(self, name=name, grid=grid, array=array, number=at, opened={})
        return self.opened[number]

    def bounds(self, number: int) -> NDArray[np.float64]:
        """Return minimum, maximum and error of the bricks of a level; see `MultilevelSource`."""
        return self.level(number).array.statistics()

    def summary(self, layout: BrickLayout) -> VolumeSummary | None:
        """Return the summary that the store keeps of its finest level; None of another level."""
        return read_statistics(self.array.summary_path, layout) if self.array.path == self.paths[0] else None

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of a box; see `Source.read`."""
        return self.array.read(begin_zyx, end_zyx)

    def read_boxes(self, boxes: Sequence[Box]) -> list[NDArray[Any]]:
        """Read the samples of several boxes; each brick is decoded once."""
        return self.array.read_boxes(boxes)


@dataclass(frozen=True)
class ZarrSource:
    """Volume in an array of zarr-python."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    array: Any
    slab: Hyperslab

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of a box; see `Source.read`."""
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        kept = self.slab.index.count(None)
        spans = iter([slice(b, e) for b, e in zip(begin_zyx, end_zyx, strict=True)][3 - kept :])
        box = tuple(next(spans) if i is None else slice(i, i + 1) for i in self.slab.index)
        return np.array(self.array[box], self.dtype, order="C").reshape(shape)


def open_ome_zarr(path: Path, subset: Subset) -> LevelSource | ZarrSource:
    """Open the finest level of a store, or the array that `subset` names.

    Raises
    ------
    DataError
        Not a store of Zarr, half written, no such array, or not a scalar volume.
    """
    where = str(path)
    with readable(path):
        known = [name for name in METADATA if (path / name).is_file()]
    if not known:
        what = "a directory without a store of Zarr" if path.is_dir() else "not a store of Zarr"
        raise DataError(what, where=where, allowed=f"a folder with {' or '.join(METADATA)}")
    found = read_json(path / known[0])
    attributes = found.get("attributes", {}) if known[0] == "zarr.json" else found
    own = attributes.get("clusterviz")
    if own and not own.get("complete"):
        raise DataError("half written", where=where, allowed="the same `clusterviz store` again, which continues it")
    scales = (attributes.get("ome", attributes).get("multiscales") or [{}])[0]
    datasets = scales.get("datasets") or [{"path": ""}]
    wanted = subset.array or datasets[0]["path"]
    described: Mapping[str, Any] = next((each for each in datasets if each["path"] == wanted), {})
    place = path / wanted
    if own:
        require_packages(where, *PACKAGES)
        array, shape = _own_array(place), tuple(own.get("shape", ()))
        for _ in range(datasets.index(described) if described else 0):
            shape = coarser(shape)
        if (array.shape_zyx, array.dtype.name) != (shape, own.get("dtype")):
            raise DataError(DISAGREE, where=str(place), found=array.shape_zyx, allowed=shape)
        axes: Sequence[Any] = scales["axes"]
        slab = select(array.metadata["shape"], f"{array.axes}zyx".upper(), subset, where, _channels(attributes))
        name, grid = _name(path, wanted, datasets, slab), _grid(slab, axes, scales, described, own, where)
        index, names = {"t": slab.time, "c": slab.channel}, [each["path"] for each in datasets]
        volume, paths = array.at(*(index[axis] for axis in array.axes)), tuple(path / each for each in names)
        return LevelSource(name, grid, volume, paths, slab, names.index(wanted), own["brick"])
    opened = _open_by_zarr(path, wanted)
    axes = scales.get("axes") or []
    dtype = check_dtype(np.dtype(opened.dtype), where)
    slab = select(opened.shape, _letters(axes, opened, subset), subset, where, _channels(attributes))
    grid = _grid(slab, axes, scales, described, {}, where)
    return ZarrSource(_name(path, wanted, datasets, slab), grid, dtype, opened, slab)


def _own_array(path: Path) -> ShardedArray:
    array = open_array(path)
    if array is None:
        raise DataError(DISAGREE, where=str(path))
    return array


def _name(path: Path, wanted: str, datasets: Sequence[Any], slab: Hyperslab) -> str:
    return f"{path}{'' if wanted == datasets[0]['path'] else ':/' + wanted}{slab.label}"


def _open_by_zarr(path: Path, wanted: str) -> Any:
    require_packages(str(path), "zarr")
    import zarr
    from zarr.errors import UnknownCodecError

    try:
        opened = zarr.open(str(path / wanted), mode="r")
    except UnknownCodecError as error:
        raise DataError(str(error), where=str(path), allowed="codecs of numcodecs and of installed packages") from error
    if not isinstance(opened, zarr.Array):
        held = ", ".join(f"{key} {array.shape}" for key, array in opened.arrays()) or "none"
        raise DataError("no array is named", where=str(path), allowed=held)
    return opened


def _letters(axes: Sequence[Any], opened: Any, subset: Subset) -> str:
    """Return the letters of the axes for `select`."""
    names = [each if isinstance(each, str) else each.get("name", "") for each in axes]
    if len(names) != opened.ndim:
        names = [name or "" for name in getattr(opened.metadata, "dimension_names", None) or []]
    if not any(names):
        return unnamed_axes(opened.ndim, subset)
    kinds = [each.get("type") if isinstance(each, dict) else None for each in axes] or [None] * len(names)
    return "".join(
        "T" if kind == "time" or name == "t" else "C" if kind == "channel" or name == "c" else "Z"
        for name, kind in zip(names, kinds, strict=True)
    )


def _channels(attributes: Mapping[str, Any]) -> list[str]:
    omero = attributes.get("ome", attributes).get("omero") or {}
    return [str(each.get("label", n)) for n, each in enumerate(omero.get("channels", []))]


def _grid(
    slab: Hyperslab, axes: Sequence[Any], scales: Mapping[str, Any], level: Mapping[str, Any], own: Any, where: str
) -> Grid:
    """Return the grid of a level: its transforms, then those of all levels."""
    count = len(slab.shape)
    scale, shift = np.ones(count), np.zeros(count)
    for each in [*level.get("coordinateTransformations", ()), *scales.get("coordinateTransformations", ())]:
        numbers = np.asarray(each.get("scale", each.get("translation", ())), float)
        if each.get("type") not in ("scale", "translation") or numbers.shape != (count,):
            allowed = f"scale and translation of {count} numbers"
            raise DataError("a transform that is not read", where=where, found=each.get("type"), allowed=allowed)
        if each["type"] == "scale":
            scale, shift = scale * numbers, shift * numbers
        else:
            shift = shift + numbers
    kept = [axis for axis, index in enumerate(slab.index) if index is None][::-1]
    spacing, origin = np.ones(3), np.zeros(3)
    spacing[: len(kept)], origin[: len(kept)] = scale[kept], shift[kept]
    direction = np.asarray(own.get("direction", np.eye(3)) if own else np.eye(3), float)
    if direction.shape != (3, 3):
        raise DataError("singular placement", where=where, found=direction.tolist(), allowed="3 × 3 numbers")
    grid = make_grid(slab.shape_zyx, direction * spacing, triple(origin, where), where)
    return replace(grid, orientation=str(own.get("orientation", ""))) if own else grid
