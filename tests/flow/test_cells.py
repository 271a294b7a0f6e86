"""Vectors on unstructured grids: from files to lines, exact where they are linear; and on a regular grid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from data import grid_writers

from clusterviz.comm import run_loopback
from clusterviz.content.flow.section import Trace
from clusterviz.errors import DataError
from clusterviz.flow.cells import open_cells, regular_vectors
from clusterviz.flow.tracing import trace

POINTS = grid_writers.GRID.points.astype(np.float64)
MIDDLE = POINTS.mean(axis=0)
# A helix around z: linear, so exact in tetrahedra.
VECTORS = np.cross((0.0, 0.0, 1.0), POINTS - MIDDLE) + np.array((0, 0, 0.1))
FORWARD = Trace(direction="forward", tolerance=1e-8)


def _vtu(path: Path) -> Path:
    numbers = " ".join(map(repr, VECTORS.ravel().tolist()))
    array = (
        f'<DataArray type="Float64" Name="U" NumberOfComponents="3" format="ascii">{numbers}</DataArray></PointData>'
    )
    grid_writers.vtu(path / "a.vtu")
    (path / "a.vtu").write_text((path / "a.vtu").read_text().replace("</PointData>", array))
    return path / "a.vtu"


def test_a_line_through_cells_of_all_kinds_is_exact_where_vectors_are_linear(tmp_path: Path) -> None:
    cells = open_cells(_vtu(tmp_path))
    seed = MIDDLE + np.array((0.1, 0, 0))
    alone = trace(cells, [seed], FORWARD)
    time = alone.lines.point_attributes["time"]
    assert time[-1] > 0.3
    helix = MIDDLE + np.stack([0.1 * np.cos(time), 0.1 * np.sin(time), 0.1 * time], axis=1)
    np.testing.assert_allclose(alone.lines.points, helix, atol=2e-6)
    assert alone.ends == {"left the data": 1}
    for one in run_loopback(3, lambda channel: trace(cells, [seed], FORWARD, channel=channel, threads=1)):
        np.testing.assert_array_equal(one.lines.points, alone.lines.points)


def test_cells_of_openfoam_have_constant_vectors(tmp_path: Path) -> None:
    cells = open_cells(grid_writers.openfoam(tmp_path / "a.foam"), "U", scale=2.0, order="zyx")
    assert cells.on_cells
    traced = trace(cells, [MIDDLE], FORWARD)
    along = traced.lines.points[-1] - MIDDLE
    np.testing.assert_allclose(along / along[2], (3, 2, 1), rtol=1e-6)
    np.testing.assert_allclose(traced.lines.point_attributes["speed"], 2 * 14**0.5, rtol=1e-6)
    assert len(traced.lines.points) > 2


def test_samples_on_a_regular_grid_are_those_of_the_cells(tmp_path: Path) -> None:
    vectors = regular_vectors(open_cells(_vtu(tmp_path)), 17)
    z, y, x = vectors.grid.shape_zyx
    assert max(z, y, x) == 17
    found = vectors.read((0, 0, 0), (z, y, x))
    index = np.moveaxis(np.indices((z, y, x))[::-1], 0, -1).reshape(-1, 3)
    places = np.array(vectors.grid.origin) + index * vectors.grid.spacing
    exact = np.cross((0.0, 0.0, 1.0), places - MIDDLE) + np.array((0, 0, 0.1))
    inside = np.isfinite(found.reshape(-1, 3)).all(axis=1)
    np.testing.assert_allclose(found.reshape(-1, 3)[inside], exact[inside], atol=1e-6)
    assert 0.1 < inside.mean() <= 1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"array": "V"}, "no such array of vectors; found V; allowed U"),
        ({"array": "f"}, r"not vectors; found f \(\d+,\); allowed U"),
        ({"order": "xxz"}, "impossible order of components"),
    ],
)
def test_what_is_no_vectors_of_a_grid_is_refused(settings: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=message):
        open_cells(_vtu(tmp_path), **settings)


def test_a_grid_without_vectors_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no vectors; found "):
        open_cells(grid_writers.vtu(tmp_path / "a.vtu"))
