"""Vectors in files, formulas and arrays, and formulas of scalars: the same numbers by every way, and clear errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from data import writers
from data.checks import check_source, refused
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from clusterviz.data import open_source
from clusterviz.data.field import FIELDS, open_field
from clusterviz.data.source import Grid
from clusterviz.data.vectors import (
    VectorArray,
    index_from_world,
    index_from_world_vectors,
    open_vectors,
    world_from_index,
)
from clusterviz.errors import DataError

SHAPE = (4, 5, 6)
VALUES = np.random.default_rng(5).normal(size=(*SHAPE, 3)).astype(np.float32)
BOX = ((1, 0, 2), (4, 3, 6))
PART = VALUES[1:4, 0:3, 2:6]


def _file(name: str, **arrays: NDArray[Any]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / name
        if name.endswith("npz"):
            np.savez_compressed(path, **arrays)
        elif name.endswith("npy"):
            np.save(path, *arrays.values())
        else:
            with h5py.File(path, "w") as file:
                file.update(arrays)
        return path

    return write


def vti(folder: Path) -> Path:
    more = {"piece": "0 5 0 4 0 3", "extra": 'NumberOfComponents="3"'}
    return writers.vti(folder / "v.vti", {"U": VALUES}, "ascii", **more)


def vtk(folder: Path) -> Path:
    parts = ("POINT_DATA 120", "SCALARS p float", "LOOKUP_TABLE default", VALUES[..., 0], "VECTORS U float", VALUES)
    return writers.vtk_parts(folder / "v.vtk", "BINARY", *parts, size="6 5 4")


UVW = dict(zip("uvw", np.moveaxis(VALUES, -1, 0), strict=True))
WRITERS: dict[str, Callable[[Path], Path]] = {
    "npy": _file("v.npy", v=VALUES),
    "npy-components-first": _file("v.npy", v=np.moveaxis(VALUES, -1, 0)),
    "npz-of-three": _file("v.npz", **UVW),
    "hdf5": _file("v.h5", **{"p": VALUES[..., 0], "flow/U": VALUES}),
    "netcdf-of-three": _file("v.nc", **UVW),
    "vtk": vtk,
    "vti": vti,
    "vtkhdf": lambda folder: writers.vtkhdf(folder / "v.vtkhdf", {"p": VALUES[..., 0], "U": VALUES}),
    "nrrd": lambda folder: writers.nrrd(folder / "v.nrrd", VALUES, kinds="vector domain domain domain"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_vectors(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path)
    vectors = open_vectors(path)
    assert vectors.grid.shape_zyx == SHAPE
    assert vectors.times == ()
    found = vectors.read(*BOX)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, PART)
    turned = open_vectors(path, order="zyx", scale=2.0).read(*BOX)
    np.testing.assert_array_equal(turned, 2 * PART[..., ::-1])


def test_steps_are_files_or_an_axis(tmp_path: Path) -> None:
    steps = np.stack([VALUES, 2 * VALUES, 3 * VALUES])
    np.save(tmp_path / "all.npy", steps)
    for number, step in zip((2, 6, 10), steps, strict=True):
        np.save(tmp_path / f"run7_{number}.npy", step)
    for path in (tmp_path / "all.npy", tmp_path / "run7_*.npy"):
        vectors = open_vectors(path, interval=0.5)
        assert vectors.times == (0.0, 0.5, 1.0)
        for number in range(3):
            np.testing.assert_array_equal(vectors.at_time(number).read(*BOX), steps[number][1:4, 0:3, 2:6])
        with pytest.raises(DataError, match=r"no such time step; found 3; allowed 0 to 2"):
            vectors.at_time(3)


def test_two_names_are_a_flow_without_the_third_component(tmp_path: Path) -> None:
    np.savez(tmp_path / "v.npz", a=VALUES[..., 0], b=VALUES[..., 1])
    found = open_vectors(tmp_path / "v.npz", "b,a").read(*BOX)
    np.testing.assert_array_equal(found, PART[..., [1, 0, 0]] * (1, 1, 0))


def _holes(folder: Path) -> Path:
    for number in (0, 10, 30):
        np.save(folder / f"s{number:03}.npy", VALUES)
    return folder / "s*.npy"


@pytest.mark.parametrize(
    ("write", "settings", "message"),
    [
        (_file("p.npy", p=VALUES[..., 0]), {}, r"p\.npy: not vectors; found 1 component .*; allowed 3 components; or"),
        (_file("p.npz", p=VALUES[..., 0], q=VALUES[0]), {}, r"p\.npz: no volume; allowed"),
        (_file("p.npz", u=VALUES[..., 0], v=VALUES[1:, :, :, 0]), {"array": "u,v"}, "volumes of different shape"),
        (_file("p.npz", u=VALUES), {"array": "u,v,w,x"}, "impossible names of arrays"),
        (_file("p.npy", u=VALUES), {"order": "xyy"}, "impossible order of components"),
        (_file("p.npy", u=VALUES), {"scale": 0.0}, "impossible scale"),
        (_file("p.npy", u=VALUES), {"time": 1}, "no such time step"),
        (vti, {"array": "V"}, r"no such array of vectors; found V; allowed U \(points\)"),
        (
            _holes,
            {},
            r"time steps are missing; found 3 files with steps 0 to 30, but none with 20; allowed one file each 10",
        ),
    ],
)
def test_what_is_no_vectors_is_refused(
    write: Callable[[Path], Path], settings: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match=message):
        open_vectors(write(tmp_path), **settings)


@pytest.mark.parametrize("name", ["no", "abc:0", "abc:8:3", "double-gyre:8:1"])
def test_unknown_formulas_are_refused(name: str) -> None:
    with pytest.raises(DataError, match=r"no such field|impossible"):
        open_vectors(f"field:{name}")


@pytest.mark.parametrize("name", ["constant", "shear", "rotation", "saddle", "abc", "hill-vortex", "double-gyre"])
def test_formulas_have_no_divergence(name: str) -> None:
    """Central differences at interior samples; those at Hill's sphere, where the derivative jumps, are left out."""
    vectors: Any = open_vectors(f"field:{name}:33").at_time(3 if name == "double-gyre" else 0)
    grid = vectors.grid
    whole = vectors.read((0, 0, 0), grid.shape_zyx).astype(np.float64)
    np.testing.assert_array_equal(vectors.read((3, 4, 5), (8, 9, 10)), whole[3:8, 4:9, 5:10].astype(np.float32))
    divergence = sum(np.gradient(whole[..., c], grid.spacing[c], axis=2 - c) for c in range(3))
    index = np.argwhere(np.ones(grid.shape_zyx, bool))[:, ::-1]
    r = np.linalg.norm(world_from_index(index, grid), axis=1).reshape(grid.shape_zyx)
    kept = np.abs(r - 0.8) > 0.15 if name == "hill-vortex" else np.ones(grid.shape_zyx, bool)
    kept[[0, -1]] = kept[:, [0, -1]] = kept[:, :, [0, -1]] = False
    largest = np.abs(np.diff(whole, axis=0)).max() / min(grid.spacing) + 1
    assert np.abs(divergence[kept]).max() < 0.02 * largest
    some = np.array([[3, 4, 5], [20, 1, 7]])
    exact = vectors.velocity(world_from_index(some, grid), vectors.times[3] if vectors.times else 0.0)
    np.testing.assert_allclose(whole[tuple(some[:, ::-1].T)], exact, atol=1e-6)


def test_vectors_of_the_world_become_those_of_a_turned_grid() -> None:
    turned = Grid((2, 3, 4), (1.0, 2.0, 4.0), (5.0, 6.0, 7.0), ((0, -1, 0), (1, 0, 0), (0, 0, 1)))
    points = np.array([[1.5, 2.0, 0.5]])
    np.testing.assert_allclose(index_from_world(world_from_index(points, turned), turned), points)
    there = world_from_index(points + 0.25 * index_from_world_vectors(np.array([[1.0, 2.0, 3.0]]), turned), turned)
    np.testing.assert_allclose(there, world_from_index(points, turned) + 0.25 * np.array([[1.0, 2.0, 3.0]]))


def test_arrays_in_memory() -> None:
    times = VectorArray(np.stack([VALUES, -VALUES]), times=(1.0, 3.0))
    np.testing.assert_array_equal(times.at_time(1).read(*BOX), -PART)
    for values, grid, steps in (
        (VALUES[..., :2], None, ()),
        (VALUES, Grid((1, 1, 1)), ()),
        (VALUES[None], None, (1, 2)),
    ):
        with pytest.raises(DataError):
            VectorArray(values, grid, steps)


@pytest.mark.parametrize("name", list(FIELDS))
@pytest.mark.parametrize("size", [1, 2, 13])
def test_a_sample_does_not_depend_on_its_box(name: str, size: int) -> None:
    source = open_field(f"field:{name}:{size}")
    whole = source.read((0, 0, 0), (size,) * 3)
    assert np.isfinite(whole).all()
    check_source(source, whole, brick=5)


@given(st.data())
def test_any_box_of_marschner_lobb(data: st.DataObject) -> None:
    source = open_field("field:marschner-lobb:20")
    whole = source.read((0, 0, 0), (20, 20, 20))
    begin = [data.draw(st.integers(0, 19)) for _ in range(3)]
    end = [data.draw(st.integers(b + 1, 20)) for b in begin]
    box = tuple(slice(b, e) for b, e in zip(begin, end, strict=True))
    np.testing.assert_array_equal(source.read(tuple(begin), tuple(end)), whole[box])  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [1, 2, 64, 1001])
def test_the_world_box(size: int) -> None:
    grid = open_field(f"field:gaussian:{size}").grid
    expected = 1.0 if size > 1 else 0.0
    np.testing.assert_allclose(np.abs(grid.corners), expected, atol=1e-14)


def test_a_size_that_fits_no_memory_is_read_by_the_box() -> None:
    source = open_field("field:shells:100001")
    middle = source.read((50000, 50000, 50000), (50001, 50001, 50001))
    assert middle.item() == pytest.approx(np.exp(-36), rel=1e-6)


def value(name: str, x: float, y: float, z: float) -> float:
    return float(FIELDS[name](*np.array([[x], [y], [z]])).item())


def test_values_that_are_known() -> None:
    assert value("ramp", -1, 0, 0) == 0
    assert value("ramp", 1, 0.3, 0.2) == 1
    assert value("constant", 0.1, 0.2, 0.3) == 0.5
    assert value("gaussian", 0, 0, 0.4) == pytest.approx(np.exp(-0.5))
    # Marschner and Lobb's formula, written out at points where its cosines are simple
    assert value("marschner-lobb", 0, 0, 0) == pytest.approx((1 + 0.25 * 2) / 2.5)
    assert value("marschner-lobb", 0, 0, 1) == pytest.approx(0.25 * 2 / 2.5)
    assert value("marschner-lobb", 1, 0, -1) == pytest.approx((2 + 0.25 * 2) / 2.5)
    assert value("marschner-lobb", 0, 2 / 3, 0) == pytest.approx((1 + 0.25 * 2) / 2.5)
    # hydrogen: the largest value is 1, 6 Bohr radii up the axis; none on the cone 3 cos² = 1
    assert value("hydrogen", 0, 0, 0.25) == pytest.approx(1)
    assert value("hydrogen", 0.2, 0, 0.2 / 2**0.5) == pytest.approx(0, abs=1e-12)
    z = np.linspace(-1, 1, 2001)
    assert FIELDS["hydrogen"](0 * z, 0 * z, z).max() == pytest.approx(1)
    assert value("shells", 0, 0.6, 0) == pytest.approx(2 / 3, rel=1e-6)


def test_x_y_and_z_are_where_they_belong() -> None:
    ramp = open_field("field:ramp:3").read((0, 0, 0), (3, 3, 3))
    np.testing.assert_array_equal(ramp, np.broadcast_to(np.float32([0, 0.5, 1]), (3, 3, 3)))
    lobes = open_field("field:hydrogen:9").read((0, 0, 0), (9, 9, 9))
    assert lobes[5, 4, 4] > 3.9 * lobes[4, 4, 5] > 0


@pytest.mark.parametrize(
    ("spec", "part"),
    [
        ("field:", "no such field"),
        ("field:nothing:3", "marschner-lobb, gaussian"),
        ("field:ramp:0", "impossible size"),
        ("field:ramp:-3", "impossible size"),
        ("field:ramp:3.5", "impossible size"),
        ("field:ramp:", "impossible size"),
        ("field:ramp:3:4", "impossible size"),
    ],
)
def test_impossible_fields(spec: str, part: str) -> None:
    refused(lambda: open_source(spec), part)
