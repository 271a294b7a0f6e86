"""Vectors in files, formulas and arrays: the same numbers by every way, and clear errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

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


def npy(path: Path) -> Path:
    np.save(path / "v.npy", VALUES)
    return path / "v.npy"


def npy_components_first(path: Path) -> Path:
    np.save(path / "v.npy", np.moveaxis(VALUES, -1, 0))
    return path / "v.npy"


def npz_of_three(path: Path) -> Path:
    np.savez_compressed(path / "v.npz", **dict(zip("uvw", np.moveaxis(VALUES, -1, 0), strict=True)))
    return path / "v.npz"


def hdf5(path: Path) -> Path:
    with h5py.File(path / "v.h5", "w") as file:
        file["p"] = VALUES[..., 0]
        file["flow/U"] = VALUES
    return path / "v.h5"


def netcdf_of_three(path: Path) -> Path:
    with h5py.File(path / "v.nc", "w") as file:
        for name, values in zip("uvw", np.moveaxis(VALUES, -1, 0), strict=True):
            file[name] = values
    return path / "v.nc"


def vtk(path: Path) -> Path:
    z, y, x = SHAPE
    head = f"# vtk DataFile Version 3.0\nt\nBINARY\nDATASET STRUCTURED_POINTS\nDIMENSIONS {x} {y} {z}\n"
    head += f"ORIGIN 0 0 0\nSPACING 1 1 1\nPOINT_DATA {x * y * z}\nSCALARS p float\nLOOKUP_TABLE default\n"
    text = head.encode() + VALUES[..., 0].astype(">f4").tobytes() + b"\nVECTORS U float\n"
    (path / "v.vtk").write_bytes(text + VALUES.astype(">f4").tobytes())
    return path / "v.vtk"


def vti(path: Path, packed: bool = False) -> Path:
    z, y, x = SHAPE
    numbers = " ".join(map(repr, VALUES.astype(float).ravel().tolist()))
    extent = f"0 {x - 1} 0 {y - 1} 0 {z - 1}"
    (path / "v.vti").write_text(
        f'<VTKFile type="ImageData"><ImageData WholeExtent="{extent}"><Piece Extent="{extent}"><PointData>'
        f'<DataArray type="Float32" Name="U" NumberOfComponents="3" format="ascii">{numbers}</DataArray>'
        "</PointData></Piece></ImageData></VTKFile>"
    )
    return path / "v.vti"


def vtkhdf(path: Path) -> Path:
    with h5py.File(path / "v.vtkhdf", "w") as file:
        root = file.create_group("VTKHDF")
        z, y, x = SHAPE
        root.attrs.update(Version=(2, 0), Type=np.bytes_("ImageData"), WholeExtent=(0, x - 1, 0, y - 1, 0, z - 1))
        root["PointData/p"], root["PointData/U"] = VALUES[..., 0], VALUES
    return path / "v.vtkhdf"


def nrrd(path: Path) -> Path:
    head = "NRRD0004\ntype: float\ndimension: 4\nsizes: 3 6 5 4\nkinds: vector domain domain domain\n"
    (path / "v.nrrd").write_bytes(
        (head + "encoding: raw\nendian: little\n\n").encode() + VALUES.astype("<f4").tobytes()
    )
    return path / "v.nrrd"


WRITERS = (npy, npy_components_first, npz_of_three, hdf5, netcdf_of_three, vtk, vti, vtkhdf, nrrd)


@pytest.mark.parametrize("write", WRITERS)
def test_every_format_gives_the_same_vectors(write: Callable[[Path], Path], tmp_path: Path) -> None:
    path = write(tmp_path)
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


def _file(name: str, **arrays: NDArray[Any]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / name
        if name.endswith("npz"):
            np.savez(path, **arrays)
        else:
            np.save(path, *arrays.values())
        return path

    return write


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
