"""HDF5 and netCDF-4 datasets (`file.h5:/path/to/dataset`, `file.nc:/temperature`), read box by box through h5py.

A file with a single volume needs no path. The names of dimensions say which axis is time. Axes without names are (time,
z, y, x), (channel, z, y, x) if a channel is named, or (time, channel, z, y, x). Attributes of the dataset, where
present: `spacing` and `origin`, world units along x, y, z; or `element_size_um`, the voxel's size along z, y, x, as
Fiji and ilastik write it. Without them the coordinate variables of a netCDF file, which must be even, define the grid.

Of the CF conventions, `_FillValue`, `missing_value`, `valid_min`, `valid_max` and `valid_range` make samples NaN, and
`scale_factor` and `add_offset` are applied. The samples are then float32, or float64 if float32 cannot hold the stored
type.

Limit: a damaged file that crashes the HDF5 library ends the rank, and with it the job, without a DataError. 5 of
144,000 damaged files did, all by a chunk shorter than its checksum. Chunks are therefore checked before they are read;
after that none of these files crashed. Opening each file first in a separate process would cost 0.2 to 0.5 s of CPU
time in every rank at every start, and would not detect what reading the samples does.

References
----------
NetCDF Climate and Forecast (CF) Metadata Conventions 1.11, sections 2.5.1, 4 and 8.1.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, select, unnamed_axes
from clusterviz.data.files import kind_of, readable, require_file, start_of
from clusterviz.data.header import check_box, check_dtype, make_grid, triple
from clusterviz.data.source import Grid, Index
from clusterviz.errors import DataError

MAX_COORDINATES = 1 << 24  # samples along an axis whose coordinates are read
MAX_UNEVENNESS = 0.01  # of a step; Gaussian latitudes and float32 coordinates are slightly uneven


@dataclass(frozen=True)
class CfValues:
    """Conversion of stored values to data values.

    Attributes
    ----------
    missing : stored values that become NaN
    valid : least and largest valid stored value; others become NaN
    scale : (slope, intercept) applied to valid values
    """

    missing: tuple[float, ...]
    valid: tuple[float, float]
    scale: tuple[float, float]

    @property
    def changes(self) -> bool:
        """Whether any value may change."""
        return bool(self.missing) or self.valid != (-np.inf, np.inf) or self.scale != (1.0, 0.0)

    def decode(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Return the data values; float64 if any may change."""
        if not self.changes:
            return stored
        slope, intercept = self.scale
        values = stored * np.float64(slope) + np.float64(intercept)
        invalid = (stored < self.valid[0]) | (stored > self.valid[1])
        for value in self.missing:
            invalid |= stored == stored.dtype.type(value)
        values[invalid] = np.nan
        return values


@dataclass(frozen=True)
class Hdf5Source:
    """Volume in a dataset; `dataset` stays open as long as the source lives.

    Attributes
    ----------
    slab : the volume's part of the dataset
    values : conversion of stored values
    """

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    dataset: Any
    slab: Hyperslab
    values: CfValues

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of a box; see `Source.read`."""
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        if 0 in shape:
            return np.empty(shape, self.dtype)
        kept = self.slab.index.count(None)
        spans = iter([slice(b, e) for b, e in zip(begin_zyx, end_zyx, strict=True)][3 - kept :])
        box = tuple(next(spans) if i is None else slice(i, i + 1) for i in self.slab.index)
        _check_chunks(self.dataset, box, self.name)
        try:
            voxels = self.dataset[box]
        except (OSError, RuntimeError) as error:  # h5py's errors for a missing filter or a damaged chunk
            raise DataError(f"the dataset cannot be read: {error}", where=self.name) from error
        return np.ascontiguousarray(self.values.decode(voxels), self.dtype).reshape(shape)


def _check_chunks(dataset: Any, box: tuple[slice, ...], where: str) -> None:
    """Check that chunks lie in the file and are longer than their checksum; other chunks crash the HDF5 library."""
    if not dataset.chunks:
        return
    least = 4 if dataset.fletcher32 else 0
    file_bytes = dataset.file.id.get_filesize()
    corners = (range(s.start - s.start % n, s.stop, n) for s, n in zip(box, dataset.chunks, strict=True))
    for corner in itertools.product(*corners):
        chunk = dataset.id.get_chunk_info_by_coord(corner)
        if chunk.byte_offset is not None and not least < chunk.size <= file_bytes - chunk.byte_offset:
            raise DataError("a damaged chunk", where=where, found=f"{chunk.size} bytes at {chunk.byte_offset}")


def open_hdf5(path: Path, subset: Subset) -> Hdf5Source:
    """Open the dataset that `subset` names, or the only volume.

    Raises
    ------
    DataError
        Not HDF5, truncated, no such dataset, several and none named, uneven coordinates, or not a scalar volume.
    """
    import h5py

    require_file(path)
    with readable(path):
        if not h5py.is_hdf5(path):
            kind = kind_of(start_of(path))
            allowed = "HDF5, or netCDF-4" + ("; nccopy -k nc4 converts classic netCDF" if kind == "netCDF 3" else "")
            raise DataError("wrong magic: not what its name says", where=str(path), found=kind, allowed=allowed)
        try:
            file = h5py.File(path, "r", locking="best-effort")
        except OSError as error:
            raise DataError(f"damaged or truncated: {error}", where=str(path)) from error
    dataset = _choose(file, subset.array, path)
    where = f"{path}:{dataset.name}"
    dtype = check_dtype(dataset.dtype, where)
    shape = dataset.shape or ()
    slab = select(shape, _letters(dataset, subset), subset, where)
    values = _cf_values(dataset, where)
    if values.changes:
        dtype = np.result_type(dtype, np.float32)
    grid = _grid_of(dataset, slab, subset, where)
    return Hdf5Source(where + slab.label, grid, dtype, dataset, slab, values)


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
    volumes = volumes or [item for item in held.values() if item.shape and len(item.shape) > 3]
    if len(volumes) != 1:
        what = f"several volumes: name one, as in {path.name}:/path" if volumes else "no 3-D dataset"
        raise DataError(what, where=str(path), allowed=listed)
    return volumes[0]


def _letters(dataset: Any, subset: Subset) -> str:
    """Return the letters of the axes for `select`, by the names of dimensions."""
    scales = [_scale(dataset, axis) for axis in range(dataset.ndim)]
    names = [dataset.dims[axis].label or _text(scale, "name") for axis, scale in enumerate(scales)]
    if not any(names):
        return unnamed_axes(dataset.ndim, subset)
    letters = [
        "T" if name.lower() in ("t", "time") or _is_time(scale) else "C" if name.lower() in ("c", "channel") else "Z"
        for name, scale in zip(names, scales, strict=True)
    ]
    if letters.count("Z") > 3 and "C" not in letters:  # members of an ensemble, bands, …
        letters[letters.index("Z")] = "C"
    return "".join(letters)


def _scale(dataset: Any, axis: int) -> Any:
    """Return the coordinate variable or dimension of an axis, or None."""
    scales = dataset.dims[axis]
    return scales[0] if len(scales) else None


def _is_time(scale: Any) -> bool:
    is_axis = _text(scale, "standard_name") == "time" or _text(scale, "axis") == "T"
    return is_axis or " since " in _text(scale, "units")


def _text(scale: Any, key: str) -> str:
    """Return a text attribute, or the last part of the name; "" without one."""
    if scale is None:
        return ""
    value = scale.name.rsplit("/", 1)[-1] if key == "name" else scale.attrs.get(key, "")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _grid_of(dataset: Any, slab: Hyperslab, subset: Subset, where: str) -> Grid:
    """Return the grid by attributes of the dataset, or by the coordinate variables of its axes."""
    given = {key: dataset.attrs[key] for key in ("spacing", "origin", "element_size_um") if key in dataset.attrs}
    if given:
        spacing = given.get("spacing", np.asarray(given.get("element_size_um", (1, 1, 1)))[::-1])
        return make_grid(slab.shape_zyx, np.diag(triple(spacing, where)), given.get("origin", (0, 0, 0)), where)
    axes = [axis for axis, index in enumerate(slab.index) if index is None]
    lines = [_line(_scale(dataset, axis), slab.shape[axis], subset.spaced, where) for axis in reversed(axes)]
    origin, steps = np.array([*lines, (0.0, 1.0)][:3]).T
    return make_grid(slab.shape_zyx, np.diag(steps), origin, where)


def _line(scale: Any, count: int, spaced: bool, where: str) -> tuple[float, float]:
    """Return the first coordinate of an axis and the step; 0 and 1 without coordinates."""
    if scale is None or scale.shape != (count,) or scale.dtype.kind not in "iuf" or count > MAX_COORDINATES:
        return 0.0, 1.0
    if _text(scale, "NAME").startswith("This is a netCDF dimension but not a netCDF variable"):
        return 0.0, 1.0
    coordinates = np.asarray(scale[()], float)
    step = float(coordinates[-1] - coordinates[0]) / (count - 1) if count > 1 else 1.0
    even = coordinates[0] + step * np.arange(count)
    if not spaced and not (np.abs(coordinates - even) <= MAX_UNEVENNESS * abs(step)).all():
        allowed = "even coordinates, or spacing: [x, y, z] of the volume"
        raise DataError(f"the coordinates {scale.name} are not evenly spaced", where=where, allowed=allowed)
    return float(coordinates[0]), step


def _cf_values(dataset: Any, where: str) -> CfValues:
    """Return the conversion that the attributes of the dataset define."""

    def numbers(key: str) -> list[float]:
        value = np.atleast_1d(np.asarray(dataset.attrs.get(key, ())))
        if value.size and value.dtype.kind not in "iuf":
            raise DataError(f"impossible {key}", where=where, found=value, allowed="numbers")
        return value.ravel().tolist()

    lows, highs = numbers("valid_min"), numbers("valid_max")
    low, high = numbers("valid_range") or [lows[0] if lows else -np.inf, highs[0] if highs else np.inf]
    missing = tuple(numbers("_FillValue") + numbers("missing_value"))
    slope, intercept = (numbers("scale_factor") or [1.0])[0], (numbers("add_offset") or [0.0])[0]
    return CfValues(missing, (low, high), (slope, intercept))
