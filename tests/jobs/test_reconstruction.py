"""Cone-beam reconstruction: the phantom comes back, blocks and ranks do not matter, impossible scans are refused."""

from __future__ import annotations

import json
import math
import runpy
from pathlib import Path

import numpy as np
import pytest
import tifffile
import yaml
from cone_beam import (
    ConeBeam,
    Window,
    load_geometry,
    parker_weights,
    ramp_kernel,
    reconstruct,
)
from jobs.phantom import GEOMETRY, phantom_grid, phantom_scan, reconstructed
from numpy.typing import NDArray

from clusterviz import jobs
from clusterviz.comm import LoopbackChannel
from clusterviz.data import open_source
from clusterviz.data.field import shepp_logan, shepp_logan_integrals
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import ClustervizError, DataError, SceneError
from clusterviz.reference.sample import trilinear

EXAMPLE = Path(__file__).parents[2] / "examples/jobs/reconstruct_ct.py"
Floats = NDArray[np.float64]


def reference(views: Floats, geometry: ConeBeam, grid: Grid) -> Floats:
    """Feldkamp's algorithm for a full circle of equal steps, float64, by the formulas of Kak and Slaney, 3.6.

    The detector lies on the axis there. Rows are convolved without a Fourier transform.
    """
    radius = geometry.source_to_axis
    p, zeta = (axis * radius / geometry.source_to_detector for axis in geometry.pixel_positions)
    step, apart = p[1] - p[0], np.arange(len(p))[:, None] - np.arange(len(p))
    ramp = np.where(apart % 2, -1 / (np.pi * step * np.where(apart, apart, 1)) ** 2, (apart == 0) / (4 * step**2))
    weighted = views * radius / np.sqrt(radius**2 + p**2 + zeta[:, None] ** 2)
    filtered = np.einsum("vrc,dc->vrd", weighted, step * ramp)
    z, y, x = (
        first + side * np.arange(n)
        for first, side, n in zip(grid.origin[::-1], grid.spacing[::-1], grid.shape_zyx, strict=True)
    )
    z, y, x = z[:, None, None], y[:, None], x
    found = np.zeros(grid.shape_zyx)
    for view, angle in zip(filtered, np.radians(geometry.angles), strict=True):
        scale = radius / (radius - x * math.cos(angle) - y * math.sin(angle))
        column = (scale * (y * math.cos(angle) - x * math.sin(angle)) - p[0]) / step + 0 * z
        row = (scale * z - zeta[0]) / (zeta[1] - zeta[0])
        values, _ = trilinear(np.stack([view, view]), column.ravel(), row.ravel(), np.zeros(column.size))
        inside = (column >= 0) & (column <= len(p) - 1) & (row >= 0) & (row <= len(zeta) - 1)
        found += np.pi / geometry.views * scale**2 * np.where(inside, values.reshape(found.shape), 0)
    return found


def phantom(size: int) -> Floats:
    """Mean of the phantom over each voxel, by 8 samples."""
    fine = [np.linspace(1 / (2 * size) - 1, 1 - 1 / (2 * size), 2 * size)] * 3
    z, y, x = np.meshgrid(*fine, indexing="ij")
    return shepp_logan(x, y, z).reshape(size, 2, size, 2, size, 2).mean(axis=(1, 3, 5))


def test_the_algorithm_is_that_of_the_textbook() -> None:
    geometry, views = phantom_scan()
    expected = reference(views.read((0, 0, 0), geometry.shape).astype(np.float64), geometry, phantom_grid(24))
    found = reconstructed(geometry, views, blocks=10)
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())
    np.testing.assert_array_equal(reconstructed(geometry, views, blocks=(24, 7, 13)), found)


SCANS = {
    "full circle": ({}, "shepp-logan", 0.012),
    "clockwise, in any order": ({"angles": [-(77 * k) % 360 for k in range(0, 360, 5)]}, "ram-lak", 0.012),
    "short scan": ({"angles": {"begin": 20, "end": 240, "count": 60}}, "ram-lak", 0.012),
    "one view missing": ({"angles": [6 * k for k in range(60) if k != 17]}, "ram-lak", 0.012),
    "smoothest": ({}, "hann", 0.018),
}


@pytest.mark.parametrize("scan", SCANS)
def test_the_phantom_comes_back(scan: str) -> None:
    changes, window, limit = SCANS[scan]
    found, expected = reconstructed(*phantom_scan(**changes), window=window), phantom(24)  # type: ignore[arg-type]
    centre = (slice(7, 17),) * 3
    assert np.sqrt(((found - expected)[centre] ** 2).mean()) < limit
    assert abs((found - expected)[centre].mean()) < 0.0015


def test_intensities_give_the_same_as_line_integrals() -> None:
    geometry, views = phantom_scan(angles={"begin": 0, "end": 360, "count": 20})
    integral = views.read((0, 0, 0), geometry.shape)
    counts = ArraySource(np.round(60000 * np.exp(-integral.astype(np.float64))).astype(np.uint16))
    found = reconstructed(geometry.model_copy(update={"unattenuated": 60000.0}), counts, size=16)
    np.testing.assert_allclose(found, reconstructed(geometry, views, size=16), atol=2e-3)


def test_parkers_weights_of_both_rays_of_a_line_sum_to_one() -> None:
    arc, fan = math.radians(230), np.radians(np.linspace(-20, 20, 9))
    angle = np.radians(np.linspace(0, 40, 21))[:, None] * (fan > -np.inf)
    both = parker_weights(angle, fan, arc) + parker_weights(angle + np.pi + 2 * fan, -fan, arc)
    is_seen_twice = angle + np.pi + 2 * fan <= arc
    np.testing.assert_allclose(both[is_seen_twice], 1)
    assert is_seen_twice.sum() > 50


def test_filters_are_the_ramp_times_their_window() -> None:
    n, spacing, share = np.arange(1, 4096), 0.5, np.array([0.1, 0.4, 0.7, 0.95])  # of the largest frequency
    windows: dict[Window, Floats] = {
        "ram-lak": np.ones(4),
        "shepp-logan": np.sinc(share / 2),
        "hann": np.cos(np.pi / 2 * share) ** 2,
    }
    for window, expected in windows.items():
        kernel = ramp_kernel(4096, spacing, window)
        found = spacing * (kernel[0] + 2 * np.cos(np.pi * share[:, None] * n) @ kernel[1:])
        np.testing.assert_allclose(found, share / (2 * spacing) * expected, rtol=2e-3, err_msg=window)


WRONG_GEOMETRIES = {
    "detector before the axis": (
        {"source_to_detector": 4},
        "source_to_detector: too small; found 4.0; allowed more than",
    ),
    "no pixels": ({"detector": [44, 0]}, r"detector\[1\]: too small; found 0; allowed at least 2"),
    "no size": ({"pixel_size": 0}, r"pixel_size\[0\]: too small; found 0; allowed more than 0"),
    "angles of nothing": ({"angles": {"begin": 0, "end": 360}}, "angles: not angles; .*allowed a list of degrees"),
    "two views": ({"angles": [0, 180]}, "angles: too few views; found 2; allowed at least 3"),
    "an angle twice": ({"angles": [0, 90, 180, 360]}, "angles: an angle occurs twice"),
    "too short": (
        {"angles": {"begin": 0, "end": 190, "count": 60}},
        "do not go far enough; found 186.* at least 208.2",
    ),
    "misses the axis": ({"offset": [3, 0]}, r"offset: the ray through the axis misses it; found \[3.0, 0.0\]"),
    "unknown key": ({"pixelsize": 3}, "pixelsize: unknown key, did you mean pixel_size"),
    "not a number": ({"source_to_axis": "far"}, "source_to_axis: not a number"),
    "nothing": (None, "source_to_axis: missing"),
}


@pytest.mark.parametrize("name", WRONG_GEOMETRIES)
def test_impossible_geometries_are_one_clear_error(name: str, tmp_path: Path) -> None:
    changes, text = WRONG_GEOMETRIES[name]
    path = tmp_path / "scan.yaml"
    path.write_text(yaml.safe_dump({} if changes is None else GEOMETRY | changes))
    with pytest.raises(SceneError, match=text) as caught:
        load_geometry(path)
    assert str(path) in str(caught.value)


def test_a_geometry_is_read_from_yaml_or_json(tmp_path: Path) -> None:
    path = tmp_path / "scan.json"
    path.write_text(json.dumps(GEOMETRY | {"pixel_size": 0.085}))
    assert load_geometry(path) == ConeBeam(**GEOMETRY)
    path.write_text("source_to_axis: [")
    with pytest.raises(SceneError, match="not YAML"):
        load_geometry(path)


def test_wrong_views_are_one_clear_error(tmp_path: Path) -> None:
    geometry, views = phantom_scan(angles={"begin": 0, "end": 360, "count": 6})
    given = views.read((0, 0, 0), geometry.shape)
    spoilt, dark = given.copy(), np.exp(-given)
    spoilt[3, 5, 7] = np.nan
    dark[4, 1, 2] = 0
    intensities = geometry.model_copy(update={"unattenuated": 1.0})
    stack = tmp_path / "views.tif"
    tifffile.imwrite(stack, given[:5])
    with pytest.raises(DataError, match=r"views.tif: not one view for each angle; found 5 views; allowed 6"):
        reconstructed(geometry, open_source(stack))
    stack.write_bytes(b"")
    with pytest.raises(DataError, match=r"views.tif"):
        reconstructed(geometry, open_source(stack))
    for case, values, text in (
        (geometry, given[:, 1:], r"of another size; found 43 rows, 48 columns; allowed .*44, 48"),
        (geometry, spoilt, r"views: view 3, row 5, column 7: a pixel has no value .*found nan"),
        (intensities, dark, r"view 4, row 1, column 2: .*found 0.0; allowed intensities of more than 0"),
    ):
        with pytest.raises(ClustervizError, match=text):
            reconstructed(case, ArraySource(values, name="views"))
    with pytest.raises(ClustervizError, match="no such window; found box; allowed ram-lak, shepp-logan, hann"):
        reconstructed(geometry, views, window="box")
    with jobs.cluster() as cluster, pytest.raises(ClustervizError, match="reaches the circle of the source"):
        reconstruct(cluster, views, geometry, Grid((8, 8, 8), (1.2, 1, 1), (-4.2, -3.5, -3.5)))


def test_the_example_scans_with_the_renderer() -> None:
    """Its pictures are the phantom's exact integrals, up to voxels."""
    changes = {"detector": [20, 24], "pixel_size": 0.17, "offset": [0, 0], "angles": [9, 77, 235]}
    geometry = ConeBeam(**GEOMETRY | changes)
    scan = runpy.run_path(str(EXAMPLE))["scan"]
    with jobs.cluster(LoopbackChannel()) as cluster:
        views = scan(cluster, open_source("field:shepp-logan:128"), geometry).read((0, 0, 0), geometry.shape)
    exact = np.array([shepp_logan_integrals(*geometry.rays(view)) for view in range(3)])
    assert np.abs(views - exact).mean() < 0.008 * exact.max()
    assert np.corrcoef(views.ravel(), exact.ravel())[0, 1] > 0.9985  # upside down, it is 0.998
