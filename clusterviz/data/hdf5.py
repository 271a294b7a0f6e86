"""HDF5 datasets (`file.h5:/path/to/dataset`), read box by box through h5py.

A file with a single 3-D dataset needs no path. Attributes of the dataset, where present: `spacing` and `origin`, world
units along x, y, z; or `element_size_um`, the voxel's size along z, y, x, as Fiji and ilastik write it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import readable, require_file
from clusterviz.data.grid import Grid
from clusterviz.data.header import check_box, check_dtype, check_shape, place, triple
from clusterviz.data.source import Index
from clusterviz.errors import DataError


@dataclass(frozen=True)
class Hdf5Source:
    """One dataset; `dataset` stays open as long as the source lives."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    dataset: Any

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """The samples of the box; see `Source.read`."""
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        if 0 in shape:
            return np.empty(shape, self.dtype)
        box = tuple(slice(b, e) for b, e in zip(begin_zyx, end_zyx, strict=True))
        try:
            voxels = self.dataset[box[3 - self.dataset.ndim :]]
        except (OSError, RuntimeError) as error:  # what h5py makes of a missing filter or a damaged chunk
            raise DataError(f"the dataset cannot be read: {error}", where=self.name) from error
        return np.ascontiguousarray(voxels, self.dtype).reshape(shape)


def open_hdf5(path: Path, array: str | None = None) -> Hdf5Source:
    """The dataset at `array`, or the only 3-D one.

    Raises
    ------
    DataError
        Not HDF5, truncated, no such dataset, several and none named, or not a scalar volume.
    """
    import h5py

    require_file(path)
    with readable(path):
        if not h5py.is_hdf5(path):
            raise DataError("wrong magic: not an HDF5 file", where=str(path))
        try:
            file = h5py.File(path, "r", locking="best-effort")
        except OSError as error:
            raise DataError(f"damaged or truncated: {error}", where=str(path)) from error
    dataset = _choose(file, array, path)
    where = f"{path}:{dataset.name}"
    dtype = check_dtype(dataset.dtype, where)
    shape_zyx = check_shape(dataset.shape, where)
    return Hdf5Source(where, _grid_of(dataset, shape_zyx, where), dtype, dataset)


def _choose(file: Any, array: str | None, path: Path) -> Any:
    import h5py

    held: dict[str, Any] = {}
    file.visititems(lambda name, item: held.update({f"/{name}": item}) if isinstance(item, h5py.Dataset) else None)
    listed = ", ".join(f"{name} {item.shape}" for name, item in held.items()) or "none: the file holds no dataset"
    if array is not None:
        dataset = file.get(array)
        if not isinstance(dataset, h5py.Dataset):
            raise DataError("no such array", where=str(path), found=array, allowed=listed)
        return dataset
    volumes = [item for item in held.values() if item.shape and len(item.shape) == 3]
    if len(volumes) != 1:
        what = "several volumes: name one, as in file.h5:/path" if volumes else "no 3-D dataset"
        raise DataError(what, where=str(path), allowed=listed)
    return volumes[0]


def _grid_of(dataset: Any, shape_zyx: Index, where: str) -> Grid:
    spacing = dataset.attrs.get("spacing")
    if spacing is None:
        spacing = np.asarray(dataset.attrs.get("element_size_um", (1, 1, 1)))[::-1]
    origin = dataset.attrs.get("origin", (0, 0, 0))
    return place(shape_zyx, np.diag(triple(spacing, where)), origin, where)
