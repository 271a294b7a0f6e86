"""VTK's data sets in HDF5 (.vtkhdf): ImageData, with or without time steps, OverlappingAMR, and UnstructuredGrid.

An unstructured grid has no time steps; its pieces are joined.

Point data lies on the samples; cell data is point data at the cells' centres. Without a name the active scalars are
taken, or the only array. Of several components `channel` is one.

Of overlapping levels (AMR) the cell data is a volume at the resolution of the finest level, which is computed when
boxes are read. A level begins as the linear interpolation of the next coarser one, between the centres of its cells,
and its boxes replace what they cover. So the finest data counts, and at the border of a level the field goes from one
to the other within a cell of the finer one. Where a neighbour is missing, a cell has the value of the coarser cell that
it lies in. Outside all boxes there is nothing (NaN).

References
----------
VTK File Formats, "VTKHDF File Format", https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, select
from clusterviz.data.formats.hdf5 import AS_STORED, Hdf5Source, check_chunks
from clusterviz.data.header import check_box, check_dtype, check_shape, make_grid, stated_numbers
from clusterviz.data.rectilinear import interpolate
from clusterviz.data.source import Grid, Index, Source
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vtk_cells import grid_of_cells
from clusterviz.data.vtk_image import HIDDEN_CELL, TYPE, ImageArray, choose_array, open_image, stated_grid
from clusterviz.errors import DataError

MOST = 1 << 36
"""Bytes of an array; a file may state more than it holds."""
IMAGES = ("ImageData", "OverlappingAMR")
MAX_LEVELS = 32


def _kind(root: Any) -> str:
    return "no group VTKHDF" if root is None else _text(root.attrs.get("Type", ""))


def is_grid(path: Path) -> bool:
    """Return whether a file holds no volume."""
    with h5py.File(path) as file:
        return _kind(file.get("VTKHDF")) not in IMAGES


def open_vtkhdf(path: Path, subset: Subset) -> Source:
    file = h5py.File(path, locking="best-effort")
    root = file.get("VTKHDF")
    if (kind := _kind(root)) not in IMAGES:
        raise DataError("not a volume", where=str(path), found=kind, allowed=", ".join(IMAGES))
    return _open_levels(root, path, subset) if kind == "OverlappingAMR" else _open_image(root, path, subset)


def _arrays(group: Any) -> list[ImageArray]:
    found = list[ImageArray]()
    for section in ("PointData", "CellData"):
        for name, dataset in group[section].items() if section in group else ():
            if shape := getattr(dataset, "shape", None):
                active = name == _text(group[section].attrs.get("Scalars", ""))
                found.append(ImageArray(name, section == "CellData", active, int(shape[-1]), dataset))
    return found


def _open_image(root: Any, path: Path, subset: Subset) -> Source:
    arrays, axes = _arrays(root), 5 if "Steps" in root else 4
    # Only with an axis of its own three samples are components; ghosts have none.
    arrays = [replace(a, components=a.components if len(a.held.shape) == axes else 1) for a in arrays]
    source: Source = open_image(arrays, subset, path, "array", partial(_source_of, root, path))[1]
    return source


def _source_of(root: Any, path: Path, array: ImageArray, subset: Subset) -> Hdf5Source:
    where = f"{path}:{array.name}"
    extent = stated_numbers(root.attrs.get("WholeExtent"), "WholeExtent", 6, where).astype(np.int64).reshape(3, 2)
    dataset = array.held
    grid = stated_grid(root.attrs, extent, array.on_cells, where)
    timed = "Steps" in root
    shape = tuple(dataset.shape)
    axes = ("T" if timed else "") + "ZYX" + ("C" if len(shape) == 4 + timed else "")
    if len(shape) != len(axes) or shape[timed : timed + 3] != grid.shape_zyx:
        raise DataError("the array's size is not the dataset's", where=where, found=shape, allowed=grid.shape_zyx)
    stated = shape
    if timed:  # steps may share what is stored
        steps_at = load_dataset(root[f"Steps/{'Cell' if array.on_cells else 'Point'}DataOffsets/{array.name}"])
        stated = (len(steps_at), *shape[1:])
    slab = select(stated, axes, replace(subset, array=None), where)
    index = slab.index
    if timed:
        at = int(steps_at[slab.time])
        if not 0 <= at < shape[0]:
            raise DataError("no such samples of a time step", where=where, found=at, allowed=f"0 to {shape[0] - 1}")
        index = (at, *index[1:])
    part = replace(slab, shape=shape, index=index)
    return Hdf5Source(where + slab.label, grid, check_dtype(dataset.dtype, where), dataset, part, AS_STORED)


@dataclass(frozen=True)
class Level:
    """Resolution of an AMR data set.

    Attributes
    ----------
    dataset : cells of the boxes, one box after another, x fastest
    first, last : int64 (n, 3), first and last cell of each box along z, y, x, in cells of the level
    begins : int64 (n,), place of each box's first cell in the dataset
    ratio : cells of this level in one of the next coarser one along z, y, x; 1 for the coarsest
    domain : int64 (2, 3), first cell of the volume and its end
    ghosts : ghost bits of the cells, in the same order; None without them
    """

    dataset: Any
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    begins: NDArray[np.int64]
    ratio: NDArray[np.int64]
    domain: NDArray[np.int64]
    ghosts: Any = None


@dataclass(frozen=True)
class LevelsSource:
    """Volume of overlapping levels, `meshes`, the coarsest first, at the resolution of the last."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    meshes: tuple[Level, ...]

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        if 0 in shape:
            return np.empty(shape, self.dtype)
        first = self.meshes[-1].domain[0]
        return self._cells(len(self.meshes) - 1, first + begin_zyx, first + end_zyx).astype(self.dtype)

    def _cells(self, number: int, begin: NDArray[np.int64], end: NDArray[np.int64]) -> NDArray[np.float64]:
        level = self.meshes[number]
        cells, missing = np.full(end - begin, np.nan), np.ones(end - begin, bool)
        begins, ends = np.maximum(level.first, begin), np.minimum(level.last + 1, end)
        for box in np.flatnonzero((begins < ends).all(axis=1)).tolist():
            part = tuple(slice(b, e) for b, e in zip(begins[box] - begin, ends[box] - begin, strict=True))
            cells[part] = self._box(level, box, begins[box], ends[box])
            missing[part] = False
        if number and missing.any():
            np.copyto(cells, self._from_coarser(number, begin, end), where=missing)
        return cells

    def _box(self, level: Level, box: int, begin: NDArray[np.int64], end: NDArray[np.int64]) -> NDArray[Any]:
        first = level.first[box]
        y, x = (level.last[box] + 1 - first)[1:].tolist()
        layers = slice(*(level.begins[box] + (np.array([begin[0], end[0]]) - first[0]) * y * x).tolist())
        check_chunks(level.dataset, (layers,), self.name)
        block = np.asarray(level.dataset[layers], np.float64)
        if level.ghosts is not None:
            check_chunks(level.ghosts, (layers,), self.name)
            block[level.ghosts[layers] & HIDDEN_CELL != 0] = np.nan
        block = block.reshape(-1, y, x)
        return block[:, begin[1] - first[1] : end[1] - first[1], begin[2] - first[2] : end[2] - first[2]]

    def _from_coarser(self, number: int, begin: NDArray[np.int64], end: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return cells that are interpolated between the centres of the coarser level's."""
        ratio, domain = self.meshes[number].ratio, self.meshes[number - 1].domain
        low = np.maximum((2 * begin + 1 - ratio) // (2 * ratio), domain[0])
        high = np.minimum((2 * end - 1 - ratio) // (2 * ratio) + 2, domain[1])
        coarse = linear = self._cells(number - 1, low, high)
        for axis in range(3):
            wanted, r = np.arange(begin[axis], end[axis]), int(ratio[axis])
            place = np.clip((wanted + 0.5) / r - 0.5, low[axis], high[axis] - 1) - low[axis]
            below = place.astype(np.int64)
            linear = interpolate(linear, below, place - below, axis)
            coarse = coarse.take(wanted // r - low[axis], axis)
        return np.where(np.isnan(linear), coarse, linear)


def _open_levels(root: Any, path: Path, subset: Subset) -> LevelsSource:
    where = str(path)
    if "Steps" in root:
        raise DataError("has time steps", where=where, allowed="overlapping levels without Steps")
    groups = list[Any]()
    while f"Level{len(groups)}" in root and len(groups) < MAX_LEVELS:
        group = root[f"Level{len(groups)}"]
        if len(group.get("AMRBox", ())):
            groups.append(group)
        else:
            break
    if not groups:
        raise DataError("no levels", where=where, allowed="Level0 with AMRBox")
    chosen = choose_array([a for a in _arrays(groups[0]) if a.on_cells], subset.array, "array of cells", path)
    name = f"{where}:{chosen.name}"
    dtype = np.result_type(check_dtype(chosen.held.dtype, name), np.float32)
    spacings = [stated_numbers(group.attrs.get("Spacing"), "Spacing", 3, name) for group in groups]
    origin = stated_numbers(root.attrs.get("Origin", np.zeros(3)), "Origin", 3, name)
    levels = list[Level]()
    for number, group in enumerate(groups):
        boxes, place = load_dataset(group["AMRBox"]).astype(np.int64), f"{name}: level {number}"
        if boxes.ndim != 2 or boxes.shape[1] != 6 or (boxes[:, 1::2] < boxes[:, ::2]).any():
            raise DataError("impossible AMRBox", where=place, found=boxes.tolist(), allowed="(n, 6)")
        first, last = boxes[:, ::2][:, ::-1], boxes[:, 1::2][:, ::-1]
        counts = np.prod((last - first + 1).astype(object), axis=1)
        dataset = group.get(f"CellData/{chosen.name}")
        if dataset is None or tuple(dataset.shape) != (sum(counts),):
            found = "nothing" if dataset is None else dataset.shape
            raise DataError("the cells do not fit", where=place, found=found, allowed=(sum(counts),))
        ratio, domain = np.ones(3, np.int64), np.stack([first.min(axis=0), last.max(axis=0) + 1])
        if number:
            exact = (spacings[number - 1] / spacings[number])[::-1]
            ratio = np.rint(exact).astype(np.int64)
            if (ratio < 1).any() or (np.abs(exact - ratio) > 1e-3).any():
                raise DataError("levels whose spacings do not fit", where=name, found=exact, allowed="whole numbers")
            inside = levels[-1].domain * ratio
            if (domain[0] < inside[0]).any() or (domain[1] > inside[1]).any():
                what = f"boxes of level {number} lie outside the first one"
                raise DataError(what, where=name, found=domain.tolist(), allowed=inside.tolist())
            domain = inside
        begins = np.cumsum(np.append(0, counts[:-1])).astype(np.int64)
        ghosts = group.get(f"CellData/{TYPE}")
        if ghosts is not None and (ghosts.shape != dataset.shape or ghosts.dtype.kind not in "iu"):
            raise DataError(f"{TYPE} does not fit", where=f"{name}: level {number}", found=ghosts.shape)
        levels.append(Level(dataset, first, last, begins, ratio, domain, ghosts))
    begin, end = levels[-1].domain
    shape = check_shape((end - begin).tolist(), name)
    select(shape, "ZYX", replace(subset, array=None), name)
    grid = make_grid(shape, np.diag(spacings[-1]), origin + (begin[::-1] + 0.5) * spacings[-1], name)
    return LevelsSource(name, grid, dtype, tuple(levels))


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def read_vtkhdf(path: Path) -> UnstructuredGrid:
    with h5py.File(path) as file:
        root = file.get("VTKHDF")
        if (kind := _kind(root)) != "UnstructuredGrid":
            raise DataError("not an unstructured grid", where=str(path), found=kind, allowed="UnstructuredGrid")
        if "Steps" in root:
            raise DataError("has time steps", where=str(path), allowed="a grid without Steps")

        def load(name: str) -> NDArray[Any]:
            return load_dataset(root[name])

        counts = {name: load(f"NumberOf{name}").astype(np.int64) for name in ("Points", "Cells", "ConnectivityIds")}
        points, types, corners = load("Points"), load("Types"), load("Connectivity").astype(np.int64)
        offsets, begins, shift = load("Offsets").astype(np.int64), [np.zeros(1, np.int64)], 0
        first = np.cumsum(counts["Cells"] + 1) - counts["Cells"] - 1
        ends = np.cumsum(counts["ConnectivityIds"])
        for piece, begin in enumerate(first.tolist()):
            begins.append(offsets[begin + 1 : begin + 1 + int(counts["Cells"][piece])] + shift)
            shift = int(ends[piece])
        if min(map(np.min, counts.values()), default=0) < 0 or ends[-1] != len(corners):
            raise DataError("the counts do not fit", where=str(path), found=f"{len(corners)} indices")
        corners += np.repeat(np.cumsum(counts["Points"]) - counts["Points"], counts["ConnectivityIds"])
        of_points, of_cells = (
            {name: load(f"{group}/{name}") for name, data in root.get(group, {}).items() if data.dtype.kind in "iuf"}
            for group in ("PointData", "CellData")
        )
    return grid_of_cells(points, types, np.concatenate(begins), corners, of_points, of_cells, str(path))


def load_dataset(data: Any) -> NDArray[Any]:
    """Return all of a dataset of HDF5, whose header may lie about its size."""
    stored = data.id.get_storage_size()
    if data.size * data.dtype.itemsize > min(MOST, 1100 * max(stored, 1)):  # deflate's most
        where, found = f"{data.file.filename}:{data.name}", f"{data.shape} in {stored} bytes"
        raise DataError("truncated, or its header lies", where=where, found=found)
    return np.asarray(data[()])
