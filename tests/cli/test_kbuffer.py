"""kbuffer: entries that pixels need, wrong pixels and comparisons of k-buffers from 14 sides, and the page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli.pages import check_page
from data.cells import lattice

from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.pages.kbuffer import measure


def write_vtk(path: Path, points: np.ndarray, grid: UnstructuredGrid) -> None:
    cells = grid.cells["hexahedron"]
    rows = " ".join(f"8 {' '.join(map(str, corners))}" for corners in cells.tolist())
    path.write_text(
        "# vtk DataFile Version 3.0\na\nASCII\nDATASET UNSTRUCTURED_GRID\n"
        f"POINTS {len(points)} double\n{' '.join(map(repr, points.ravel().tolist()))}\n"
        f"CELLS {len(cells)} {9 * len(cells)}\n{rows}\n"
        f"CELL_TYPES {len(cells)}\n{'12 ' * len(cells)}\nPOINT_DATA {len(points)}\nSCALARS f double 1\n"
        f"LOOKUP_TABLE default\n{' '.join(map(repr, grid.point_arrays['f'].tolist()))}\n"
    )


def test_page_and_numbers(cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "DRAWN", (2,))
    grid = lattice(5, 5, 5)
    points = grid.points * [1, 1, 6] + 0.2 * np.random.default_rng(1).uniform(-1, 1, grid.points.shape)
    path, folder = tmp_path / "a.vtk", tmp_path / "found"
    write_vtk(path, points, grid)
    outcome = cli(
        "kbuffer", str(path), "-o", str(folder), "--size", "24x18", "--device", "cpu", "-D", "opacity=0.2", "--json"
    )
    assert (outcome.status, outcome.err) == (0, "")
    numbers = json.loads((folder / "kbuffer.json").read_text())
    assert json.loads(outcome.out) == numbers
    assert {path.name for path in folder.iterdir()} == {f"kbuffer.{end}" for end in ("json", "npy", "png")} | {
        "index.html"
    }
    needed = np.load(folder / "kbuffer.npy")
    assert (needed.shape, len({view["name"] for view in numbers["views"]})) == ((14, 18, 24), 14)
    assert numbers["wrong"] == {str(k): int((needed > k).sum()) for k in range(2, needed.max() + 1)}
    assert needed.max() > 2
    exact, *buffers, table = numbers["drawings"]
    assert (exact["k"], [(each["k"], each["entries"]) for each in buffers]) == (
        0,
        [(2, "sorted"), (2, "unsorted")],
    )
    for each in buffers:
        assert each["counts"]["comparisons"] == each["by_formula"] > 0
        assert each["counts"]["wrong_pixels"] == numbers["wrong"].get(str(each["k"]), 0)
        assert each["differing"] <= each["counts"]["wrong_pixels"]
    assert (table["integration"], table["counts"]["wrong_pixels"]) == ("table", 0)
    page = (folder / "index.html").read_text()
    assert len(check_page(page)) == 2
    assert "k = 2, unsorted" in page
