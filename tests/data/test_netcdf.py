"""netCDF-4 files of the netCDF library: dimension scales, coordinates and CF attributes."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from data.checks import check_placed, check_source, refused, values

from clusterviz.data import open_source, open_volume
from clusterviz.data.axes import Subset
from clusterviz.scene import Volume

Coordinates = dict[str, np.ndarray | int]
LINES: Coordinates = {"level": np.array([10.0, 30, 50]), "lat": np.array([4.0, 2, 0, -2]), "lon": np.arange(5) * 0.5}


def write(path: Path, array: np.ndarray, lines: Coordinates, **attributes: object) -> Path:
    """Write one variable, `t`; a line that is a number is a dimension without coordinates."""
    with h5py.File(path, "w") as file:
        for name, line in lines.items():
            if isinstance(line, int):
                file.create_dataset(name, (line,), ">f4")
                file[name].make_scale("This is a netCDF dimension but not a netCDF variable.         5")
            else:
                file[name] = line
                file[name].make_scale(name)
        file.create_dataset("t", data=array, chunks=True, compression="gzip")
        for dim, name in zip(file["t"].dims, lines, strict=True):
            dim.attach_scale(file[name])
        file["t"].attrs.update(attributes)
        if "when" in file:
            file["when"].attrs["units"] = "hours since 1900-01-01"
    return path


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", ["i1", "u2", "i4", "f4", "f8"])
def test_coordinates_place_the_samples(tmp_path: Path, dtype: str, order: str) -> None:
    array = values(order + dtype, (3, 4, 5))
    source = open_source(write(tmp_path / "a.nc", array, LINES))
    check_source(source, array)
    check_placed(source, np.array([[0.5, 0, 0, 0], [0, -2, 0, 4], [0, 0, 20, 10], [0, 0, 0, 1.0]]))
    assert source.name == f"{tmp_path}/a.nc:/t"


def test_time_members_and_dimensions_without_coordinates(tmp_path: Path) -> None:
    array = values("f4", (2, 6, 3, 4, 5))
    path = write(tmp_path / "a.nc4", array, {"when": np.arange(2.0), "member": 6, "z": 3, "y": 4, "x": 5})
    check_source(open_source(path, subset=Subset(time=1, channel=4)), array[1, 4])
    assert open_source(path, subset=Subset(time=1, channel=4)).grid.spacing == (1, 1, 1)
    refused(lambda: open_source(path, subset=Subset(channel=4)), "several time steps", "2 time steps")
    refused(lambda: open_source(path, subset=Subset(time=0)), "several channels", "6 channels")
    flat = write(tmp_path / "b.nc", array[:, 0, 0], {"time": 2, "lat": LINES["lat"], "lon": LINES["lon"]})
    check_source(open_source(flat, subset=Subset(time=1)), array[1:, 0, 0])


def test_missing_values_are_nan_and_packed_ones_are_unpacked(tmp_path: Path) -> None:
    array = np.arange(60, dtype=">i2").reshape(3, 4, 5)
    expected = array * 0.5 + 100
    expected[array == 7] = expected[array == 8] = np.nan
    expected[(array < 2) | (array > 50)] = np.nan
    attributes = {"_FillValue": np.int16(7), "missing_value": np.array([8], "i2"), "scale_factor": 0.5}
    attributes |= {"add_offset": 100.0, "valid_range": np.array([2, 50], "i2")}
    check_source(open_source(write(tmp_path / "a.nc", array, LINES, **attributes)), expected.astype("f4"))
    wide = array.astype("f8")
    found = open_source(write(tmp_path / "b.nc", wide, LINES, _FillValue=9.0, valid_min=1.0, valid_max=40.0))
    check_source(found, np.where((wide == 9) | (wide < 1) | (wide > 40), np.nan, wide))
    refused(lambda: open_source(write(tmp_path / "c.nc", wide, LINES, scale_factor="half")), "impossible scale_factor")


def test_uneven_coordinates_need_a_spacing(tmp_path: Path) -> None:
    array = values("f4", (3, 4, 5))
    path = write(tmp_path / "a.nc", array, {**LINES, "level": np.array([10.0, 20, 50])})
    refused(lambda: open_source(path), "/level are not evenly spaced", r"spacing: \[x, y, z\]")
    placed = open_volume(Volume(path=str(path), spacing=(1, 2, 3)))
    check_source(placed, array)
    assert placed.grid.spacing == (1, 2, 3)
    near = write(tmp_path / "b.nc", array, {**LINES, "level": np.array([10.0, 30.1, 50])})
    assert open_source(near).grid.spacing == pytest.approx((0.5, 2, 20))


def test_classic_netcdf_is_told_how_to_be_converted(tmp_path: Path) -> None:
    (tmp_path / "a.nc").write_bytes(b"CDF\1" + bytes(100))
    refused(lambda: open_source(tmp_path / "a.nc"), "found netCDF 3", "nccopy -k nc4")
