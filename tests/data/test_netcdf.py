"""netCDF: classic files, the CF conventions of coordinates and values, and uneven coordinates."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import h5py
import netCDF4
import numpy as np
import pytest
from data import writers
from data.checks import check_placed, check_source, cut, refused, values

from clusterviz.data import open_source, open_volume
from clusterviz.data.axes import Subset
from clusterviz.data.rectilinear import line_of
from clusterviz.scene import Volume

FORMS = ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA", "NETCDF4"]
LINES = {
    "time": ([0.0, 6.0], {"units": "hours since 2000-01-01"}),
    "lev": ([0.0, 50.0, 100.0], {"units": "m", "positive": "down"}),
    "lat": ([30.0, 20.0, 10.0, 0.0], {"units": "degrees_north"}),
    "lon": ([350.0, 352.0, 354.0, 356.0, 358.0], {"standard_name": "longitude"}),
}
PACKED = {"scale_factor": 0.5, "add_offset": 100.0, "_FillValue": np.int16(-3), "missing_value": np.int16(4)}
LEVELS, ROWS = np.array([10.0, 20, 50]), np.array([4.0, 2.5, 0.5, -0.5])


def write(path: Path, form: str, array: np.ndarray, axes: tuple[str, ...] = tuple(LINES), **attributes: Any) -> Path:
    """A variable `t` along `axes`, and a second one of records, which gives the first one gaps."""
    with netCDF4.Dataset(path, "w", format=form) as file:
        file.title = "of the file"
        for name, (line, described) in LINES.items():
            file.createDimension(name, None if name == "time" else len(line))
            variable = file.createVariable(name, "f8", (name,))
            variable[:] = line
            variable.setncatts(described)
        variable = file.createVariable("t", array.dtype, axes, fill_value=attributes.pop("_FillValue", None))
        variable.set_auto_maskandscale(False)
        variable[:] = array
        variable.setncatts(attributes)
        file.createVariable("odd", "i1", ("time", "lat"))[:] = np.ones((2, 4))
    return path


@pytest.mark.parametrize("form", FORMS)
def test_values_are_those_of_the_library(tmp_path: Path, form: str) -> None:
    stored = np.arange(-60, 60, dtype="i2").reshape(2, 3, 4, 5)
    path = write(tmp_path / "a.nc", form, stored, **PACKED)
    with netCDF4.Dataset(path) as file:
        expected = file["t"][1].filled(np.nan).astype("f4")
    assert np.isnan(expected).sum() == 1
    source = open_source(path, subset=Subset(time=1))
    check_source(source, expected)
    # x is longitude, y latitude, z up: depth is negated.
    check_placed(source, np.array([[2, 0, 0, 350], [0, -10, 0, 30], [0, 0, -50, 0], [0, 0, 0, 1]]))
    refused(lambda: open_source(path), "several time steps")
    refused(lambda: open_source(path, "/gone"), "no such array", "/t", "/odd")
    refused(lambda: open_source(path, "lat"), "1 axes")
    if form != "NETCDF4":
        for count in (1, path.stat().st_size // 2, path.stat().st_size // 4):
            refused(lambda count=count: open_source(cut(path, count)), "lies about its size")


@pytest.mark.parametrize("dtype", ["i1", "i2", "i4", "f4", "f8", "u1", "u2", "u4", "i8", "u8"])
def test_types_of_classic_files(tmp_path: Path, dtype: str) -> None:
    array = values(dtype, (3, 4, 5))
    form = "NETCDF3_64BIT_DATA" if dtype[0] == "u" or dtype == "i8" else "NETCDF3_CLASSIC"
    source = open_source(write(tmp_path / "a.nc", form, array, ("lev", "lat", "lon")))
    if dtype in ("i2", "i4", "u2", "u4"):  # which have a value for samples that were never written, NaN
        expected = array.astype(np.result_type(dtype, "f4"))
        expected[array == (np.iinfo(dtype).max if dtype[0] == "u" else -np.iinfo(dtype).max)] = np.nan
        array = expected
    check_source(source, array)


@pytest.mark.parametrize(
    ("form", "dtype"), [*((form, "f4") for form in FORMS), *(("NETCDF4", t) for t in ("i2", "u4", "f8"))]
)
def test_samples_that_were_never_written(tmp_path: Path, form: str, dtype: str) -> None:
    path = write(tmp_path / "a.nc", form, np.zeros((2, 3, 4, 5), "i2"))
    with netCDF4.Dataset(path, "a") as file:
        for name in ("part", "own"):
            own = {"fill_value": np.dtype(dtype).type(-7 if dtype[0] != "u" else 7)} if name == "own" else {}
            file.createVariable(name, dtype, ("lev", "lat", "lon"), **own)[:2] = np.arange(40).reshape(2, 4, 5)
        expected = file["part"][:].filled(np.nan) if dtype[0] == "f" else file["part"][:].astype("f8").filled(np.nan)
    assert np.isnan(expected[2]).all()
    for name in ("part", "own"):
        kept = expected.copy()
        kept[0, 1, 2] = np.nan if name == "own" and dtype[0] == "u" else 7
        check_source(open_source(path, name), kept.astype(np.result_type(dtype, "f4")))


@pytest.mark.parametrize(
    ("axes", "turned"),
    [
        (("lon", "lat", "lev"), [[0, 0, 2, 350], [0, -10, 0, 30], [-50, 0, 0, 0], [0, 0, 0, 1]]),
        (("lat", "lev", "lon"), [[2, 0, 0, 350], [0, 0, -10, 30], [0, -50, 0, 0], [0, 0, 0, 1]]),
        (("lev", "lon"), [[2, 0, 0, 350], [0, 0, 1, 0], [0, -50, 0, 0], [0, 0, 0, 1]]),
    ],
)
def test_axes_in_any_order(tmp_path: Path, axes: tuple[str, ...], turned: list[list[float]]) -> None:
    array = values("f4", tuple(len(LINES[name][0]) for name in axes))
    source = open_source(write(tmp_path / "a.nc", "NETCDF3_CLASSIC", array, axes), "t")
    check_source(source, array.reshape(source.grid.shape_zyx))
    check_placed(source, np.array(turned, float))


def test_unsigned_numbers_in_signed_ones_and_a_fill_value_beyond_the_type(tmp_path: Path) -> None:
    array = values("u1", (3, 4, 5))
    expected = array.astype("f4")
    expected[array == 255] = np.nan
    part = {"_Unsigned": "true", "_FillValue": np.int8(-1), "missing_value": 1e20}
    path = write(tmp_path / "a.nc", "NETCDF3_CLASSIC", array.view("i1"), ("lev", "lat", "lon"), **part)
    check_source(open_source(path), expected)
    short = array.astype("i2")
    short[0, 0, :2] = -32767, -1
    path = write(tmp_path / "b.nc", "NETCDF3_CLASSIC", short, ("lev", "lat", "lon"), _Unsigned="true")
    expected = short.view("u2").astype("f4")
    expected[0, 0, 0] = np.nan
    check_source(open_source(path), expected)


def test_pressure_rises_downwards(tmp_path: Path) -> None:
    path = write(tmp_path / "a.nc", "NETCDF3_CLASSIC", values("f4", (3, 4, 5)), ("lev", "lat", "lon"))
    with netCDF4.Dataset(path, "a") as file:
        file["lev"].delncattr("positive")
        file["lev"].units = "hPa"
    assert open_source(path).grid.direction[2] == (0, 0, -1)


def test_uneven_coordinates_are_those_of_a_lattice(tmp_path: Path) -> None:
    array = values("f4", (3, 4, 5)).clip(-9, 9)
    array[0, 0, 2] = 1
    path = writers.netcdf(tmp_path / "a.nc", array, {"level": LEVELS, "lat": ROWS, "lon": np.arange(5) * 0.5})
    levels, rows = np.arange(10.0, 51, 10), np.arange(4, -1, -0.5)
    lattice = np.apply_along_axis(lambda line: np.interp(levels, LEVELS, line), 0, array)
    lattice = np.apply_along_axis(lambda line: np.interp(-rows, -ROWS, line), 1, lattice)
    lattice = np.where(np.isnan(lattice), np.nan, lattice)
    finite = open_source(path)
    assert finite.grid.shape_zyx == (5, 10, 5)
    check_placed(finite, np.array([[0.5, 0, 0, 0], [0, -0.5, 0, 4], [0, 0, 10, 10], [0, 0, 0, 1]]))
    expected = finite.read((0, 0, 0), (5, 10, 5))
    np.testing.assert_allclose(expected[:, :, 3:], lattice[:, :, 3:], rtol=1e-6, atol=1e-6)
    check_source(finite, expected)  # boxes equal the whole
    # A stored sample next to an invalid one keeps its value.
    assert np.isnan(array[0, 0, 2]) == np.isnan(expected[0, 0, 2])
    np.testing.assert_array_equal(expected[[0, 1, 4]][:, [0, 3, 7, 9]], array)
    placed = open_volume(Volume(path=str(path), spacing=(1, 2, 3)))
    check_source(placed, expected)  # of the lattice, whose axes it stretches
    assert placed.grid.spacing == (1, 2, 3)


@pytest.mark.parametrize(
    ("units", "steps", "found"),
    [
        (("m", "m", "km"), (1, 1, 1000), ""),
        (("km", "km", "m"), (1, 1, 0.001), ""),
        (("", "m", "m"), (1, 1, 1), ""),
        (("furlong", "furlong", ""), (1, 1, 1), ""),
        (("m", "m", "hPa"), (1, 1, -1), "m, m, hPa"),
        (("degrees_east", "degrees_north", "degree"), (1, 1, 1), ""),
        (("degrees_east", "degrees_north", ""), (1, 1, 1), "degrees, degrees, none"),
        (("degrees_east", "degrees_north", "m"), (1, 1, 1), "degrees, degrees, m"),
    ],
)
def test_axes_in_several_units(tmp_path: Path, units: tuple[str, ...], steps: tuple[float, ...], found: str) -> None:
    lines = {"z": np.arange(3.0), "y": np.arange(4.0), "x": np.arange(5.0)}
    path = writers.netcdf(tmp_path / "a.nc", values("f4", (3, 4, 5)), lines)
    with h5py.File(path, "a") as file:
        for name, unit in zip("xyz", units, strict=True):
            file[name].attrs["units"] = unit
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_placed(open_source(path), np.diag([*steps, 1.0]))
        told, caught[:] = [str(each.message) for each in caught], []
        placed = open_volume(Volume(path=str(path), spacing=(1, 2, 3)))
        assert not caught
    assert placed.grid.spacing == (1, 2, 3)
    assert len(told) == bool(found)
    assert all(
        "different units, whose numbers are taken as they are" in each and f"found {found};" in each for each in told
    )


@pytest.mark.parametrize(
    ("coordinates", "expected"),
    [
        ([10.0, 30.1, 50], [0, 1, 2]),
        ([0.0, 1, 3], [0, 1, 3]),
        ([1000.0, 925, 850, 700, 500], [0, 3, 6, 12, 20]),
        (np.array([0.1, 0.2, 0.4, 0.75], "f4"), [0, 2, 6, 13]),
        ([0.0, 1, 3**0.5, 3.7182818], [0, 15, 26, 56]),
        (np.float32(359) + np.arange(700, dtype="f4") * np.float32(0.0009), list(range(700))),
        (np.array([4000.0, 4000.001, 4000.003, 4000.004], "f4"), [0, 1, 3, 4]),
        (90 - np.degrees(np.arccos(np.polynomial.legendre.leggauss(640)[0])), list(range(640))),
        ([0.0, 1e-9, 1], "too fine a lattice"),
        ([0.0, 2, 1, 5], "impossible coordinates"),
        ([0.0, np.nan, 1], "impossible coordinates"),
    ],
)
def test_lattices_of_coordinates(coordinates: Any, expected: list[int] | str) -> None:
    if isinstance(expected, str):
        refused(lambda: line_of(np.array(coordinates), False, "lev", "a.nc"), expected)
    else:
        assert line_of(np.array(coordinates), False, "lev", "a.nc").places.tolist() == expected


def test_a_lattice_that_is_too_fine(tmp_path: Path) -> None:
    lines = {"z": np.array([0.0, 1, 9e5]), "y": ROWS, "x": np.array([0.0, 1, 2, 3, 5000])}
    path = writers.netcdf(tmp_path / "a.nc", values("f4", (3, 4, 5)), lines)
    refused(lambda: open_source(path), "too fine a lattice", "900001", "at most 64 times")
    placed = open_volume(Volume(path=str(path), spacing=(1, 2, 3)))
    check_source(placed, values("f4", (3, 4, 5)))
    assert placed.grid.spacing == (1, 2, 3)
