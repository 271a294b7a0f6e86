"""HDF5 and netCDF datasets (`file.h5:/path/to/dataset`, `file.nc:/temperature`), read box by box.

h5py reads HDF5 and netCDF-4; classic netCDF is read by `clusterviz.data.classic_netcdf`. A file with a single volume
needs no path. The names of dimensions say which axis is time. Axes without names are (time, z, y, x), (channel, z, y,
x) if a channel is named, or (time, channel, z, y, x). Attributes of the dataset, where present: `spacing` and `origin`,
world units along x, y, z; or `element_size_um`, the voxel's size along z, y, x, as Fiji and ilastik write it. Without
them the coordinate variables of a netCDF file define the grid; uneven ones as in `clusterviz.data.rectilinear`.

By the CF conventions an axis is x, y or z of the world, in whatever order a file has them, and a coordinate that is
`positive` downwards is negated. Longitude and latitude stay degrees: there is no projection. `_FillValue`,
`missing_value`, `valid_min`, `valid_max` and `valid_range` make samples NaN, as does what netCDF fills in where nothing
was written, and `scale_factor` and `add_offset` are applied. The samples are then float32, or float64 if float32 cannot
hold the stored type. `_Unsigned` makes integers unsigned.

Limit: a damaged file that crashes the HDF5 library ends the rank, and with it the job, without a DataError. 5 of
144,000 damaged files did, all by a chunk shorter than its checksum. Chunks are therefore checked before they are read;
after that none of these files crashed. Opening each file first in a separate process would cost 0.2 to 0.5 s of CPU
time in every rank at every start, and would not detect what reading the samples does.

References
----------
NetCDF Climate and Forecast (CF) Metadata Conventions 1.11, sections 2.5.1, 4 and 8.1.
NetCDF User's Guide, appendix A, "Attribute Conventions" (`_Unsigned`), and "Fill Values".
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, UnnamedPartError, select, unnamed_axes
from clusterviz.data.classic_netcdf import read_classic
from clusterviz.data.files import GADGET, explained, kind_of, start_of
from clusterviz.data.header import axis_factors, check_box, check_dtype, make_grid, triple, unit_factors
from clusterviz.data.rectilinear import Line, even_line, line_of, placed
from clusterviz.data.source import Grid, Index, Source
from clusterviz.errors import DataError

MAX_COORDINATES = 1 << 24  # samples along an axis whose coordinates are read
PRESSURES = ("pa", "hpa", "kpa", "bar", "mbar", "millibar", "mb", "dbar", "decibar", "atm", "pascal", "hectopascal")
"""Units of coordinates that rise downwards."""


@dataclass(frozen=True)
class CfValues:
    """Conversion of stored values to data values.

    Attributes
    ----------
    missing : stored values that become NaN
    valid : least and largest valid stored value; others become NaN
    scale : (slope, intercept) applied to valid values
    stored : dtype of the stored values, if not that of the dataset
    """

    missing: tuple[float, ...]
    valid: tuple[float, float]
    scale: tuple[float, float]
    stored: np.dtype[Any] | None = None

    @property
    def changes(self) -> bool:
        return bool(self.missing) or self.valid != (-np.inf, np.inf) or self.scale != (1.0, 0.0)

    def decode(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Return the data values; float64 if any may change."""
        stored = stored if self.stored is None else stored.view(self.stored)
        if not self.changes:
            return stored
        slope, intercept = self.scale
        values = stored * np.float64(slope) + np.float64(intercept)
        invalid = (stored < self.valid[0]) | (stored > self.valid[1])
        for value in self.missing:
            invalid |= stored == value
        values[invalid] = np.nan
        return values


_LARGE = 9.969209968386869e36
FILLED: dict[str, Any] = {"i2": np.int16(-32767), "i4": np.int32(-2147483647), "f4": np.float32(_LARGE)}
FILLED |= {"u2": np.uint16(65535), "u4": np.uint32(4294967295), "f8": np.float64(_LARGE)}
"""What netCDF fills in by type where nothing was written. It notes this in files of HDF5; classic ones do not tell."""
AS_STORED = CfValues((), (-np.inf, np.inf), (1.0, 0.0))


@dataclass(frozen=True)
class Hdf5Source:
    """Volume in a dataset; `dataset` stays open as long as the source lives."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    dataset: Any
    slab: Hyperslab
    values: CfValues

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        if 0 in shape:
            return np.empty(shape, self.dtype)
        box = self.slab.box(begin_zyx, end_zyx)
        check_chunks(self.dataset, box, self.name)
        with explained("the dataset cannot be read", self.name, OSError, RuntimeError):  # no filter, a damaged chunk
            voxels = self.dataset[box]
        return np.ascontiguousarray(self.values.decode(voxels), self.dtype).reshape(shape)


def check_chunks(dataset: Any, box: tuple[slice, ...], where: str) -> None:
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


def open_hdf5(path: Path, subset: Subset) -> Source:
    """Open the dataset that `subset` names, or the only volume."""
    held = read_classic(path) if start_of(path).startswith(b"CDF") else _datasets(path, subset.array)
    dataset = choose_dataset(held, subset, path)
    return open_dataset(dataset, subset, f"{path}:{dataset.name}")


def open_dataset(dataset: Any, subset: Subset, where: str) -> Source:
    """Open a dataset of h5py, or what has its attributes; parameters and errors as of `open_hdf5`."""
    dtype = check_dtype(dataset.dtype, where)
    slab = select(dataset.shape or (), _letters(dataset, subset), subset, where)
    values = _cf_values(dataset, dtype, where)
    dtype = values.stored.newbyteorder("=") if values.stored else dtype
    if values.changes:
        dtype = np.result_type(dtype, np.float32)
    source = Hdf5Source(where + slab.label, Grid(slab.shape_zyx), dtype, dataset, slab, values)
    return _on_grid(source, subset, where)


def _datasets(path: Path, array: str | None) -> dict[str, Any]:
    import h5py  # slow to import

    if not h5py.is_hdf5(path):
        kind = kind_of(start_of(path))
        raise DataError("wrong magic: not what its name says", where=str(path), found=kind, allowed="HDF5, or netCDF")
    with explained("damaged or truncated", path, OSError):
        file = h5py.File(path, "r", locking="best-effort")
    held: dict[str, Any] = {}
    if array is not None and isinstance(file.get(array), h5py.Dataset):
        held[array.lstrip("/")] = file[array]
    file.visititems(lambda name, item: held.update({name: item}) if isinstance(item, h5py.Dataset) else None)
    return held


def choose_dataset(held: Mapping[str, Any], subset: Subset, path: Path) -> Any:
    """Return the dataset that is named, or the only one with three axes of space, or else of three axes or more."""
    listed = ", ".join(f"{item.name} {item.shape}" for item in held.values()) or "none: the file holds no dataset"
    if subset.array is not None:
        if subset.array.lstrip("/") not in held:
            raise DataError("no such array", where=str(path), found=subset.array, allowed=listed)
        return held[subset.array.lstrip("/")]
    volumes = [item for item in held.values() if item.shape and len(item.shape) > 2]
    if not volumes and any(name.startswith("PartType") for name in held):
        allowed = "a table of its particles with columns x, y and z, as .csv or .npy"
        raise DataError(f"{GADGET} is not read", where=str(path), allowed=allowed)
    if subset.vectors:
        volumes = [item for item in volumes if _channels(item, subset) == 3]
    spatial = [item for item in volumes if _letters(item, subset).count("Z") == 3]
    volumes = [item for item in spatial if len(item.shape) == 3] or spatial or volumes
    if not volumes and not subset.vectors:  # fields on a plane, but not the two bounds of each cell of an axis
        planes = [item for item in held.values() if len(item.shape or ()) == 2 and min(item.shape) > 2]
        volumes = [item for item in planes if _letters(item, subset) == "ZZ"]
    if not volumes:
        what = "no array of vectors" if subset.vectors else "no 3-D dataset"
        raise DataError(what, where=str(path), allowed=listed)
    if len(volumes) > 1:  # the largest comes first, since others may be coarser levels
        volumes.sort(key=lambda item: -prod(item.shape) * (item.dtype.kind in "iufb"))
        names = [item.name for item in volumes]
        raise UnnamedPartError("array", names, where=str(path), allowed=listed, noun="volume")
    return volumes[0]


def _channels(dataset: Any, subset: Subset) -> int:
    """Return the number of channels of a dataset; 0 without an axis of them."""
    letters = _letters(dataset, subset)
    return int(dataset.shape[letters.index("C")]) if "C" in letters else 0


def _letters(dataset: Any, subset: Subset) -> str:
    """Return the letters of the axes for `select`, by the names of dimensions."""
    names, scales = _axes(dataset)
    if not any(names):
        letters = unnamed_axes(dataset.shape or (), subset)
        return letters.replace("Y", "Z").replace("X", "Z")
    found = [
        "T" if name in ("t", "time") or _is_time(scale) else "C" if name in ("c", "channel") else "Z"
        for name, scale in zip(names, scales, strict=True)
    ]
    if found.count("Z") > 3 and "C" not in found:  # members of an ensemble, bands, …
        is_last = subset.vectors and found[-1] == "Z" and dataset.shape[-1] == 3
        found[-1 if is_last else found.index("Z")] = "C"
    return "".join(found)


def _axes(dataset: Any) -> tuple[list[str], list[Any]]:
    scales = [_scale(dataset, axis) for axis in range(len(dataset.shape or ()))]
    names = [dataset.dims[axis].label or _text(scale, "name") for axis, scale in enumerate(scales)]
    return [name.lower() for name in names], scales


def _scale(dataset: Any, axis: int) -> Any:
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


AXES = {
    "X": ("x", "lon", "longitude", "degrees_east", "projection_x_coordinate", "grid_longitude"),
    "Y": ("y", "lat", "latitude", "degrees_north", "projection_y_coordinate", "grid_latitude"),
    "Z": ("z", "lev", "level", "height", "altitude", "depth", "plev", "air_pressure"),
}
"""Names, standard names and units of the coordinates along each axis of the world."""


def _world_axis(name: str, scale: Any) -> str:
    """Return X, Y, Z, or "" if nothing tells which axis of the world it is."""
    told = _text(scale, "axis").upper()
    if told in AXES:
        return told
    words = (_text(scale, "standard_name"), _text(scale, "units"), name)
    found = next((axis for word in words for axis, known in AXES.items() if word in known), "")
    return found or ("Z" if _is_down(scale) or _text(scale, "positive") else "")


def _is_down(scale: Any) -> bool:
    told = _text(scale, "positive").lower()
    return told == "down" or (not told and _text(scale, "units").lower().rstrip("s") in PRESSURES)


def _on_grid(source: Hdf5Source, subset: Subset, where: str) -> Source:
    """Return the volume on the grid that the dataset's attributes state, or the coordinate variables of its axes."""
    dataset, slab = source.dataset, source.slab
    given = {key: dataset.attrs[key] for key in ("spacing", "origin", "element_size_um") if key in dataset.attrs}
    if given:
        spacing = given.get("spacing", np.asarray(given.get("element_size_um", (1, 1, 1)))[::-1])
        steps, origin = np.diag(triple(spacing, where)), given.get("origin", (0, 0, 0))
        return replace(source, grid=make_grid(slab.shape_zyx, steps, origin, where))
    names, scales = _axes(dataset)
    kept = [axis for axis, index in enumerate(slab.index) if index is None][::-1]
    lines = [_line(scales[axis], slab.shape[axis], subset.spaced, where) for axis in kept]
    told = [_world_axis(names[axis], scales[axis]) for axis in kept]
    signs = [-1.0 if _is_down(scales[axis]) else 1.0 for axis in kept]
    if len(kept) == 2:
        lines, told, signs = [*lines, even_line(1)], [*told, ""], [*signs, 1.0]
    rest = [letter for letter in "XYZ" if letter not in told]
    if len(rest) == 1 and told.count("") == 1:
        told[told.index("")] = rest[0]
    if sorted(told) != ["X", "Y", "Z"]:
        told = ["X", "Y", "Z"]
    units = [_unit(scales[axis]) if slab.shape[axis] > 1 else "" for axis in kept] + [""] * (3 - len(kept))
    lines = _in_one_unit(lines, units, told, subset.spaced, where)
    axes = np.zeros((3, 3))
    for column, (letter, sign) in enumerate(zip(told, signs, strict=True)):
        axes["XYZ".index(letter), column] = sign
    found: Source = placed(source, lines, axes, subset.spaced)
    return found


def _unit(scale: Any) -> str:
    """Return the unit of the coordinates of an axis: "degrees" for all kinds of degrees, "none" without one."""
    unit = _text(scale, "units").strip()
    return "degrees" if unit.lower().startswith("degree") else unit or "none"


def _in_one_unit(
    lines: Sequence[Line], units: Sequence[str], told: Sequence[str], spaced: bool, where: str
) -> list[Line]:
    """Return lines in the unit of x; where there is no common unit, as they are, and warn of it unless `spaced`.

    `units` are empty where there is one sample; `told` are the axes of the world along which the lines run.
    """
    if "degrees" not in units:  # numbers of layers beside lengths are of any unit, but not beside degrees
        units = [unit.replace("none", "") for unit in units]
    order = sorted(range(3), key=lambda n: told[n])
    ordered = [units[n] for n in order]
    factors = (unit_factors(ordered) or [1.0] * 3) if spaced else axis_factors(ordered, where)
    each = [factors[order.index(n)] for n in range(3)]
    return [replace(line, first=line.first * f, step=line.step * f) for line, f in zip(lines, each, strict=True)]


def _line(scale: Any, count: int, spaced: bool, where: str) -> Line:
    """Return the coordinates of an axis; 0, 1, … without a variable of them."""
    if scale is None or scale.shape != (count,) or scale.dtype.kind not in "iuf" or count > MAX_COORDINATES:
        return even_line(count)
    if _text(scale, "NAME").startswith("This is a netCDF dimension but not a netCDF variable"):
        return even_line(count)
    return line_of(scale[()], spaced, scale.name, where)


def _cf_values(dataset: Any, dtype: np.dtype[Any], where: str) -> CfValues:
    """Return the conversion that the attributes of the dataset define; `dtype` is the native one of stored values."""
    unsigned = dataset.dtype.kind == "i" and _text(dataset, "_Unsigned").lower() == "true"
    stored = np.dtype(dataset.dtype.str.replace("i", "u")) if unsigned else None

    def numbers(key: str) -> list[float]:
        value = np.atleast_1d(np.asarray(dataset.attrs.get(key, ())))
        if value.size and value.dtype.kind not in "iuf":
            raise DataError(f"impossible {key}", where=where, found=value, allowed="numbers")
        if stored is not None and value.dtype.kind == "i" and key not in ("scale_factor", "add_offset"):
            value = value.astype(f"u{value.dtype.itemsize}")
        return value.ravel().tolist()

    lows, highs = numbers("valid_min"), numbers("valid_max")
    low, high = numbers("valid_range") or [lows[0] if lows else -np.inf, highs[0] if highs else np.inf]
    filled = () if "_FillValue" in dataset.attrs else _filled(dataset, stored or dtype)
    missing = (*numbers("_FillValue"), *numbers("missing_value"), *filled)
    slope, intercept = (numbers("scale_factor") or [1.0])[0], (numbers("add_offset") or [0.0])[0]
    return CfValues(missing, (low, high), (slope, intercept), stored)


def _filled(dataset: Any, stored: np.dtype[Any]) -> tuple[float, ...]:
    """Return the stored value of netCDF's samples that were never written, if the dataset has it.

    Integers of 64 bits have none here: they may be labels, which floats do not hold.
    """
    default = FILLED.get(dataset.dtype.str[1:])
    if default is None or getattr(dataset, "fillvalue", default) != default:
        return ()
    return (float(default.view(stored.newbyteorder("="))),)
