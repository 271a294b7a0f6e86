"""Scattered data: exact at points, a float64 reference between them, layers, files of points, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data import grid_writers, mesh_writers
from data.checks import check_source, refused
from numpy.typing import NDArray

from clusterviz.content.volume.section import Scattered, Volume
from clusterviz.data import open_source, open_volume, read_geometry
from clusterviz.data.axes import Subset
from clusterviz.data.scattered import scattered
from clusterviz.reference.pyramid import pull_push
from clusterviz.scene import load_scene


def stations(count: int, seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    draw = np.random.default_rng(seed)
    return draw.uniform([-3, 10, 1e3], [5, 14, 1e3 + 2], (count, 3)), draw.normal(0, 7, count)


@pytest.mark.parametrize(("size", "count"), [(24, 60), ((9, 20, 7), 300), ((30, 11), 40), ((1, 5, 8), 25)])
def test_volume_is_that_in_float64(size: Any, count: int) -> None:
    positions, values = stations(count)
    source = scattered(positions, values, size)
    sides, grid = np.array(source.sides), source.grid
    low, length = positions.min(axis=0), np.ptp(positions, axis=0)
    np.testing.assert_allclose(grid.corners[0], low)
    np.testing.assert_allclose((grid.corners[-1] - low)[sides[::-1] > 1], length[sides[::-1] > 1])
    steps = length / np.maximum(sides[::-1] - 1, 1)
    assert isinstance(size, tuple) or steps.max() < 1.1 * steps.min()
    nearest = np.minimum(np.rint((positions - low) / steps).astype(int), sides[::-1] - 1)[:, ::-1]
    sums, counts = np.zeros(sides), np.zeros(sides)
    np.add.at(sums, tuple(nearest.T), values)
    np.add.at(counts, tuple(nearest.T), 1)
    means = sums / np.maximum(counts, 1)
    expected = pull_push(means[..., None], (counts > 0).astype(float))[..., 0]
    voxels = source.read((0, 0, 0), grid.shape_zyx)
    np.testing.assert_allclose(voxels, np.broadcast_to(expected, grid.shape_zyx), atol=2e-5)
    np.testing.assert_array_equal(voxels[tuple(nearest.T)], means.astype(np.float32)[tuple(nearest.T)])
    check_source(source, voxels)


def test_few_and_odd_points() -> None:
    one = scattered(np.array([[1.0, 2.0, 3.0]]), np.array([5.0]))
    assert one.grid.shape_zyx == (2, 2, 2)
    np.testing.assert_array_equal(one.read((0, 0, 0), (2, 2, 2)), 5)
    np.testing.assert_array_equal(one.grid.origin, (1, 2, 3))
    twice = scattered(np.array([[0, 0.0], [0, 0], [4, 2]]), np.array([1.0, 3.0, 8.0]), 5)
    assert (twice.grid.shape_zyx, twice.grid.spacing) == ((2, 3, 5), (1, 1, 1))
    voxels = twice.read((0, 0, 0), (2, 3, 5))
    assert (voxels[0, 0, 0], voxels[1, 2, 4]) == (2, 8)
    positions, values = stations(50)
    known = scattered(positions, values, 16, (-1, 3, 10, 14, 1000, 1002))
    wrong, lost = positions.copy(), values.copy()
    wrong[0, 1], wrong[1, 0], lost[2], lost[3], wrong[4] = np.nan, np.inf, np.nan, -np.inf, 1e300
    left = np.delete(np.arange(50), range(5))
    bounds = (-1, 3, 10, 14, 1000, 1002)
    found = scattered(np.concatenate([wrong, [[3.001, 12, 1001]]]), np.append(lost, 1e6), 16, bounds)
    np.testing.assert_array_equal(found.voxels, scattered(positions[left], values[left], 16, bounds).voxels)
    assert np.abs(known.voxels).max() <= np.abs(values).max() * (1 + 1e-6)
    for scale in (1e-9, 1e9):
        moved = scattered(positions * scale, values, 16)
        np.testing.assert_allclose(
            moved.grid.spacing, np.multiply(scattered(positions, values, 16).grid.spacing, scale)
        )


def test_what_is_refused() -> None:
    positions, values = stations(4)
    refused(lambda: scattered(positions[:0], values[:0]), "no points with a value; found 0 points")
    refused(lambda: scattered(positions, values * np.nan), "no points with a value; found 4 points, of which 4 are")
    refused(lambda: scattered(positions, values, 9, (0, 1, 0, 1, 0, 1)), "of which 0 are inside", "inside the bounds")
    refused(lambda: scattered(positions, values, 9, (0, 1, 0, 1)), "wrong bounds")
    refused(lambda: scattered(positions, values, 9, (0, np.inf, 0, 1, 0, 1)), "wrong bounds")
    refused(lambda: scattered(positions[:, :1], values), "wrong shapes")
    refused(lambda: scattered(positions, values[:3]), "wrong shapes")
    refused(lambda: scattered(positions, values, (0, 3, 3)), "wrong size of the grid")
    refused(lambda: scattered(positions, values, (2000, 2000, 2000)), "too large a grid", "2000 × 2000 × 2000")


def test_files_of_points(tmp_path: Path) -> None:
    positions, values = stations(30)
    (tmp_path / "a.csv").write_text(
        "depth,X,Y,Z,well\n" + "\n".join(f"{v},{x},{y},{z},A" for (x, y, z), v in zip(positions, values, strict=True))
    )
    expected = scattered(positions, values, 12).voxels
    for scene in ("{path: a.csv, scattered: {size: 12}}", "{path: a.csv, array: depth, scattered: {size: [12]}}"):
        (tmp_path / "scene.yaml").write_text(f"volumes: [{scene}]")
        source = open_volume(load_scene(tmp_path / "scene.yaml").volumes[0])
        np.testing.assert_array_equal(source.read((0, 0, 0), source.grid.shape_zyx), expected)
    (tmp_path / "flat.csv").write_text("x,y,a,b\n0,0,1,2\n4,0,3,4\n0,8,5,6\n")
    np.testing.assert_array_equal(read_geometry(tmp_path / "flat.csv").points.positions[:, 2], 0)  # type: ignore[union-attr]
    volume = Volume(path=str(tmp_path / "flat.csv"), array="b", scattered=Scattered(size=(3,)), spacing=(1, 1, 1))
    source = open_volume(volume)
    assert (source.grid.shape_zyx, source.grid.spacing) == ((2, 3, 2), (1, 1, 1))
    np.testing.assert_array_equal(source.read((0, 0, 0), (1, 3, 2))[0, [0, 0, 2], [0, 1, 0]], [2, 4, 6])
    scattering = Subset(scattered=Scattered(size=(3,)))
    refused(lambda: open_source(tmp_path / "flat.csv", subset=scattering), "several arrays: name one", "a, b")
    refused(lambda: open_source(tmp_path / "flat.csv"), "unknown extension", "files of points with the key scattered")
    refused(lambda: open_volume(volume.model_copy(update={"array": "c"})), "no such array; found c; allowed a, b")
    refused(lambda: open_source(tmp_path / "gone.csv", subset=scattering), "no such file")


@pytest.mark.parametrize(("kind", "least", "largest"), [("vtp-raw", 1, 8), ("csv", 0, 4), ("vtu-raw", 0, 10)])
def test_other_files_of_points(kind: str, least: float, largest: float, tmp_path: Path) -> None:
    name, make = (mesh_writers.FILES | grid_writers.FILES)[kind]
    make(tmp_path / name)
    source = open_source(tmp_path / name, subset=Subset(scattered=Scattered(size=(20,))))
    voxels = source.read((0, 0, 0), source.grid.shape_zyx)
    assert (voxels.min(), voxels.max()) == (least, largest)  # two vertices of the mesh are at one place, with 0 and 4
