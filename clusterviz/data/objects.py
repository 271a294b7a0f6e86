"""Volumes in memory as objects of other libraries, which are told by their attributes: none of them is imported.

Images and rectilinear grids of pyvista, images of nibabel, SimpleITK and ITK, and arrays and datasets of xarray are
placed and divided into arrays, time steps and channels as files of VTK, NIfTI, MetaImage and netCDF are. To add a
library, write a function with the parameters of `_nibabel` and add a line to `LIBRARIES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, select
from clusterviz.data.classic_netcdf import ClassicDimension
from clusterviz.data.formats.hdf5 import choose_dataset, open_dataset
from clusterviz.data.formats.nifti import placed_volume
from clusterviz.data.header import check_box, check_dtype, make_grid
from clusterviz.data.source import Grid, Index, Source
from clusterviz.data.vtk_image import ImageArray, choose_array, image_grid, rectilinear


@dataclass(frozen=True)
class ObjectSource:
    """Volume in an array of another library, which is copied only when a box is read.

    Attributes
    ----------
    array : numbers (z, y, x)
    owner : what must live as long as the array, whose memory it may be
    """

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    array: NDArray[Any]
    slab: Hyperslab
    owner: Any = None

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        check_box(begin_zyx, end_zyx, self.slab.shape_zyx)
        box = tuple(slice(begin, end) for begin, end in zip(begin_zyx, end_zyx, strict=True))
        return np.array(self.array[box], self.dtype, order="C", copy=True)


def open_object(given: Any, subset: Subset, where: str) -> Source | None:
    for attributes, opener in LIBRARIES:
        if all(hasattr(given, name) for name in attributes):
            return opener(given, subset, where)
    return None


def _source(array: NDArray[Any], axes: str, subset: Subset, where: str) -> ObjectSource:
    """Return the volume that a subset names in an array, on a grid without a place; axes as of `select`."""
    slab = select(array.shape, axes, replace(subset, array=None), where)
    volume = array[tuple(slice(None) if i is None else i for i in slab.index)].reshape(slab.shape_zyx)
    return ObjectSource(where + slab.label, Grid(slab.shape_zyx), check_dtype(array.dtype, where), volume, slab)


def _nibabel(given: Any, subset: Subset, where: str) -> Source:
    slab, grid = placed_volume(given.shape, np.asarray(given.affine, float), replace(subset, array=None), where)
    part = tuple(slice(None) if i is None else i for i in slab.index[::-1])[: len(given.shape)]
    array = np.asanyarray(given.dataobj[part]).T.reshape(grid.shape_zyx)  # of a file only this part is read
    return ObjectSource(where + slab.label, grid, check_dtype(array.dtype, where), array, slab)


def _itk(given: Any, subset: Subset, where: str) -> Source:
    package: Any = import_module(type(given).__module__.partition(".")[0])
    view = getattr(package, "GetArrayViewFromImage", None) or package.array_view_from_image
    array, spacing, origin = np.asarray(view(given)), list(given.GetSpacing()), list(given.GetOrigin())
    sides = len(spacing)
    source = _source(array, "TZYX"[-sides:] + "C" * (array.ndim - sides), subset, where)
    steps, place, count = np.eye(3), np.zeros(3), min(3, sides)
    steps[:count, :count] = np.asarray(given.GetDirection(), float).reshape(sides, sides)[:count, :count]
    steps[:, :count] *= spacing[:count]
    place[:count] = origin[:count]
    grid = make_grid(source.slab.shape_zyx, steps, place, where)
    return replace(source, grid=replace(grid, orientation="LPS"), owner=given)


def _pyvista_arrays(given: Any) -> Iterator[ImageArray]:
    for on_cells, arrays in ((False, given.point_data), (True, given.cell_data)):
        for name in arrays.keys():  # noqa: SIM118 (not all are mappings)
            values = np.asarray(arrays[name])
            yield ImageArray(name, on_cells, name == given.active_scalars_name, values.size // len(values), values)


def _pyvista(given: Any, subset: Subset, where: str) -> Source:
    points = np.asarray(given.dimensions)
    chosen = choose_array(list(_pyvista_arrays(given)), subset.array, "array", Path(where))
    samples = np.maximum(points - 1, 1) if chosen.on_cells else points
    source = _source(chosen.held.reshape(*samples[::-1], chosen.components), "ZYXC", subset, f"{where}:{chosen.name}")
    if not hasattr(given, "spacing"):
        lines = [np.asarray(each) for each in (given.x, given.y, given.z)]
        return rectilinear(source, lines, chosen.on_cells, subset.spaced, where)
    steps = np.asarray(getattr(given, "direction_matrix", np.eye(3)), float) * np.asarray(given.spacing, float)
    first = np.asarray(given.extent[::2], float)
    grid = image_grid(points, steps, np.asarray(given.origin, float), first, chosen.on_cells, where)
    return replace(source, grid=grid)


@dataclass(frozen=True)
class _Variable:
    """Array of xarray, with the attributes of h5py's datasets that the reader of netCDF uses."""

    data: Any
    chunks: None = None

    @property
    def name(self) -> str:
        return str(self.data.name or "array")

    @property
    def dtype(self) -> np.dtype[Any]:
        found: np.dtype[Any] = np.dtype(self.data.dtype)
        return found

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(self.data.shape)

    @property
    def attrs(self) -> Mapping[str, Any]:
        return dict(self.data.attrs)

    @property
    def dims(self) -> list[ClassicDimension]:
        """Axes: names, and coordinates along them; those that are points of time tell a time axis."""
        found = []
        for name in self.data.dims:
            scales = (_Variable(self.data.coords[name]),) if name in self.data.coords else ()
            is_time = any(scale.dtype.kind == "M" for scale in scales)
            found.append(ClassicDimension("time" if is_time else str(name), scales))
        return found

    def __getitem__(self, box: Any) -> NDArray[Any]:
        return np.asarray(self.data[box].values)


def _xarray(given: Any, subset: Subset, where: str) -> Source:
    if hasattr(given, "data_vars"):
        held = {str(name): _Variable(array) for name, array in given.data_vars.items()}
        return open_dataset(choose_dataset(held, subset, Path(where)), subset, where)
    return open_dataset(_Variable(given), subset, where)


LIBRARIES: tuple[tuple[tuple[str, ...], Callable[[Any, Subset, str], Source]], ...] = (
    (("affine", "dataobj", "shape"), _nibabel),
    (("GetSpacing", "GetOrigin", "GetDirection"), _itk),
    (("dims", "coords", "attrs"), _xarray),
    (("dimensions", "spacing", "origin", "point_data", "cell_data"), _pyvista),
    (("dimensions", "meshgrid", "point_data", "cell_data"), _pyvista),
)
"""Attributes of the volumes of each library, and the function that opens one."""
