"""info: description of data files."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data import grid_writers, mesh_writers, writers
from PIL import Image as Pillow

from clusterviz.cli.info import format_name, histograms_of, sparkline


@pytest.fixture
def file(tmp_path: Path) -> Path:
    values = np.arange(2 * 3 * 70, dtype=np.int16).reshape(2, 3, 70)
    np.save(tmp_path / "a.npy", values)
    return tmp_path / "a.npy"


def test_json_holds_what_the_file_holds(cli: Callable[..., Any], file: Path) -> None:
    outcome = cli("info", str(file), "--json", "--brick", "32")
    assert outcome.status == 0
    found = json.loads(outcome.out)
    assert found["format"] == "npy"
    assert found["dtype"] == "int16"
    assert found["shape_zyx"] == [2, 3, 70]
    assert (found["samples"], found["bytes"]) == (420, 840)
    assert (found["minimum"], found["maximum"]) == (0, 419)
    assert found["percentiles"]["50"] == np.percentile(np.arange(420), 50)
    assert found["not_finite"] == 0
    assert sum(found["histogram"]) == 420
    assert found["bricks"] == {"side": 32, "counts_zyx": [1, 1, 3], "count": 3}
    assert found["bounds"] == [[0, 0, 0], [69, 2, 1]]


def test_text_shows_grid_type_range_and_bricks(cli: Callable[..., Any], file: Path) -> None:
    out = cli("info", str(file)).out
    assert "70 × 3 × 2 (x, y, z), int16, 840 bytes" in out
    assert "0  to  419" in out
    assert "2 of 64³ (2 × 1 × 1)" in out
    assert "not finite" not in out


def test_nan_and_inf_are_counted_not_shown_as_range(cli: Callable[..., Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([[[1, math.nan, math.inf, 4]]], np.float32))
    out = cli("info", str(tmp_path / "a.npy")).out
    assert "2 of 4 samples" in out
    assert "1  to  4" in out


def test_uneven_coordinates_show_what_is_stored(cli: Callable[..., Any], tmp_path: Path) -> None:
    lines = {"z": np.array([0.0, 1, 4]), "y": np.arange(4.0), "x": np.arange(5.0)}
    path = writers.netcdf(tmp_path / "a.nc", np.zeros((3, 4, 5)), lines)
    out = cli("info", str(path)).out
    assert "5 × 4 × 5 (x, y, z), float64" in out
    assert "5 × 4 × 3 samples at uneven coordinates" in out


def test_a_volume_of_nan_has_no_range(cli: Callable[..., Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((2, 2, 2), math.nan))
    outcome = cli("info", str(tmp_path / "a.npy"), "--json")
    assert json.loads(outcome.out)["minimum"] is None
    assert "range" not in cli("info", str(tmp_path / "a.npy")).out


def test_time_steps_and_channels_are_told(cli: Callable[..., Any], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.arange(3 * 2 * 4, dtype=np.uint8).reshape(3, 2, 2, 2, 1))
    out = cli("info", str(tmp_path / "a.npy")).out
    assert "3; this is 0" in out
    assert "0, 1; this is 0" in out
    found = json.loads(cli("info", str(tmp_path / "a.npy"), "--time", "2", "--channel", "1", "--json").out)
    assert (found["time_steps"], found["time"], found["channels"], found["channel"]) == (3, 2, [0, 1], 1)
    assert (found["minimum"], found["maximum"]) == (20, 23)
    outcome = cli("info", str(tmp_path / "a.npy"), "--time", "3")
    assert outcome.status == 2
    assert "no such time step" in outcome.err


def test_a_field_has_no_file(cli: Callable[..., Any]) -> None:
    assert json.loads(cli("info", "field:ramp:8", "--json").out)["shape_zyx"] == [8, 8, 8]


def test_a_mesh_lines_and_points_of_one_file(cli: Callable[..., Any], tmp_path: Path) -> None:
    path = str(mesh_writers.vtp(tmp_path / "a.vtp"))
    found = json.loads(cli("info", path, "--json").out)
    assert (found["name"], found["format"]) == (path, "vtp")
    mesh, lines, points = found["mesh"], found["lines"], found["points"]
    assert (mesh["triangles"], mesh["vertices"], mesh["drawn"], mesh["dtype"]) == (4, 9, 4, "float32")
    assert (mesh["closed"], mesh["boundary_edges"], mesh["non_manifold_edges"]) == (True, 0, 0)
    assert mesh["bounds"] == [[0, 0, 0], [2, 3, 4]]
    label = {"dtype": "int64", "components": 1, "minimum": 4, "maximum": 6, "not_finite": 0}
    assert mesh["triangle_arrays"] == {"label": label}
    assert (lines["lines"], lines["points"], lines["bounds"]) == (2, 5, [[0, 0, 0], [6, 5, 5]])
    assert (points["points"], points["arrays"]["heat"]["maximum"]) == (2, 4)
    out = cli("info", path).out
    for part in ("4 triangles, 9 vertices, float32", "closed       yes", "label: int64, 4  to  6", "2 lines, 5 points"):
        assert part in out


def test_what_a_mesh_cannot_draw_is_told(cli: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 nan\nf 1 2 3\nf 1 2 4\nf 1 1 2\n")
    out = cli("info", str(path)).out
    for part in (
        "no: 3 boundary and 0 non-manifold edges",
        "1 of 3 triangles, which are not drawn",
        "1 positions (NaN",
    ):
        assert part in out
    found = json.loads(cli("info", str(path), "--json").out)["mesh"]
    assert (found["drawn"], found["degenerate"], found["not_finite"]) == (1, 1, 1)
    path.write_text("v 0 0 0\nf 1 2 3\n")
    outcome = cli("info", str(path))
    assert (outcome.status, outcome.out) == (2, "")
    assert "a.obj: an index of a vertex is out of range; found 1; allowed 0 to 0" in outcome.err
    (tmp_path / "a.gltf").write_text('{"asset": {"version": "2.0"}}')
    assert "nothing to draw" in cli("info", str(tmp_path / "a.gltf")).out


def test_an_unstructured_grid_and_its_flaws(cli: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "a.vtu"
    content = grid_writers.vtu(path).read_text()
    found = json.loads(cli("info", str(path), "--json").out)
    assert (found["format"], found["grid"]["tetrahedra"], found["grid"]["boundary_faces"]) == ("vtu", 12, 20)
    path.write_text(content.replace("5 9 6 11", "5 6 6 11").replace("4 5 6 7 10", "7 6 5 4 10"))
    out = cli("info", str(path)).out
    for part in (
        "1 tetra, 1 pyramid, 1 wedge, 1 hexahedron",
        "11, with 18 faces at the boundary",
        "1 cells whose corners are in the order of a mirror image",
        "1 cells without a volume",
        "point array  f: float32, 0  to  10",
    ):
        assert part in out
    path.write_text(content.replace('Name="types"', 'Name="kinds"'))
    outcome = cli("info", str(path))
    assert (outcome.status, outcome.out) == (2, "")
    assert "a.vtu: Cells lack an array" in outcome.err


def test_columns_of_an_array_are_points_when_asked(cli: Callable[..., Any], tmp_path: Path) -> None:
    path = str(mesh_writers.npy(tmp_path / "a.npy", structured=False))
    assert json.loads(cli("info", path, "--json").out)["shape_zyx"] == [1, 5, 4]
    assert json.loads(cli("info", path, "--points", "--json").out)["points"]["points"] == 5


@pytest.mark.parametrize("name", ["a.npy", "a.npz", "a.vtk"])
def test_a_damaged_file_that_may_hold_a_volume_is_one(name: str, cli: Callable[..., Any], tmp_path: Path) -> None:
    path = writers.write(tmp_path / name)
    path.write_bytes(path.read_bytes()[: 200 if name == "a.npz" else -40])
    outcome = cli("info", str(path))
    assert (outcome.status, outcome.out) == (2, "")
    assert re.search(f"{name}: .*(truncated|ends early)", outcome.err)
    assert "no such file" in cli("info", str(tmp_path / f"gone-{name}")).err


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a/b.NII.gz", "nifti"),
        ("x.h5:/t/rho", "hdf5"),
        ("field:ramp:8", "field"),
        ("e.map.gz", "mrc"),
        ("b.tiff", "tiff"),
    ],
)
def test_the_format_is_known_by_name(name: str, expected: str) -> None:
    assert format_name(name) == expected


def test_sparkline_is_high_where_counts_are_and_blank_where_none_are() -> None:
    assert sparkline([0, 1, 10**6]) == " ▁█"
    assert sparkline([0, 0]) == "  "
    assert len(sparkline([1] * 256)) == 64


def test_the_histogram_is_drawn(cli: Callable[..., Any], octahedron: Path, tmp_path: Path) -> None:
    """Of a volume with its percentiles, and of each array of a grid; not without values, nor into another format."""
    plot = tmp_path / "a.png"
    np.save(tmp_path / "a.npy", np.random.default_rng(0).normal(5, 2, (9, 10, 11)).astype(np.float32))
    grid = grid_writers.vtu(tmp_path / "a.vtu")
    heights = []
    for name in (tmp_path / "a.npy", grid):
        assert cli("info", str(name), "--plot", str(plot)).status == 0
        with Pillow.open(plot) as picture:
            heights.append(picture.size[1])
            assert np.asarray(picture.convert("L")).min() < 100
    assert heights[0] < heights[1]
    for arguments, message in (
        ((str(octahedron), "--plot", str(plot)), "nothing to plot"),
        ((str(grid), "--plot", str(tmp_path / "a.svg")), "not a name for the plot"),
    ):
        outcome = cli("info", *arguments)
        assert (outcome.status, message in outcome.err) == (2, True), outcome.err


def test_what_is_drawn_of_an_array() -> None:
    vectors, gaps = np.array([[3.0, 4.0], [0.0, 0.0]]), np.array([1.0, np.nan, 2.0])
    found = histograms_of({"v": vectors, "g": gaps, "none": np.array([np.nan])})
    assert [(each.name, each.low, each.high, sum(each.counts)) for each in found] == [("v", 0, 5, 2), ("g", 1, 2, 2)]
    assert found[1].percentiles[50.0] == 1.5
