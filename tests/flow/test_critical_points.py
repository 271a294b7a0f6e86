"""Critical points: found once each, at the exact place, with the type of their Jacobian, on any ranks."""

from __future__ import annotations

import csv
from collections import Counter
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import run_loopback
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray
from clusterviz.flow.cells import Cells, make_cells
from clusterviz.flow.critical_points import COLUMNS, find_critical_points

TURN = np.array([[0.6, -0.8, 0.0], [0.48, 0.36, -0.8], [0.64, 0.48, 0.6]])  # so that no axis is special
SPIRAL = [[0.1, -2, 0], [2, 0.1, 0], [0, 0, 1]]
JACOBIANS = {
    "source": np.diag([1.0, 2, 3]),
    "sink": np.diag([-1.0, -2, -3]),
    "saddle 1": np.diag([-1.0, -2, 3]),
    "saddle 2": np.diag([1.0, 2, -3]),
    "spiral source": np.array(SPIRAL),
    "spiral sink": -np.array(SPIRAL),
    "spiral saddle 1": np.array(SPIRAL) * ((-1,), (-1,), (1,)),
    "spiral saddle 2": np.array(SPIRAL) * ((1,), (1,), (-1,)),
    "center": np.array([[0.0, -2, 0], [2, 0, 0], [0, 0, 1]]),
}
GRID = Grid((6, 7, 8), (0.1, 0.2, 0.15), (5.0, 6.0, 7.0), ((0, -1, 0), (1, 0, 0), (0, 0, 1)))


def _places(grid: Grid) -> Any:
    index = np.moveaxis(np.indices(grid.shape_zyx)[::-1], 0, -1)
    matrix = grid.world_from_index
    return index @ matrix[:3, :3].T + matrix[:3, 3]


def _cube() -> tuple[Any, Any]:
    """Corners of a cube, and six tetrahedra around its diagonal."""
    paths = [np.cumsum(np.eye(3, dtype=int)[list(each)], axis=0) for each in permutations(range(3))]
    corners = [[0, *(path @ (1, 2, 4))] for path in paths]
    return np.array([[n & 1, n >> 1 & 1, n >> 2] for n in range(8)], float), np.array(corners)


def _linear_cells(jacobian: Any, place: Any) -> Cells:
    points, corners = _cube()
    return make_cells(points, corners, (points - place) @ jacobian.T, False)


@pytest.mark.parametrize("kind", JACOBIANS)
def test_the_type_is_that_of_the_jacobian(kind: str) -> None:
    jacobian = TURN.T @ JACOBIANS[kind] @ TURN
    places = _places(GRID)
    middle = places[2, 3, 4] + 0.3 * (places[3, 4, 5] - places[2, 3, 4])
    of_grid = find_critical_points(VectorArray((places - middle) @ jacobian.T, GRID))
    inside = np.array((0.5, 0.3, 0.2))
    for found, place in ((of_grid, middle), (find_critical_points(_linear_cells(jacobian, inside)), inside)):
        assert found.types == (kind,)
        np.testing.assert_allclose(found.positions, [place], atol=1e-6)
        exact = sorted(np.linalg.eigvals(jacobian), key=lambda value: (-value.real, -value.imag))
        np.testing.assert_allclose(np.sort(found.eigenvalues[0]), np.sort(exact), atol=1e-4)


@pytest.mark.parametrize("place", [(0.5, 0.5, 0.5), (0.5, 0.5, 0.2), (0.0, 0.0, 0.0)])
def test_a_point_between_cells_is_found_once(place: Any) -> None:
    assert find_critical_points(_linear_cells(TURN, np.array(place))).types == ("spiral source",)
    grid = Grid((5, 5, 5), (0.5, 0.5, 0.5), (-1, -1, -1))
    found = find_critical_points(VectorArray((_places(grid) - place) @ TURN.T, grid))
    assert found.types == ("spiral source",)
    np.testing.assert_allclose(found.positions, [place], atol=1e-9)


def _waves(side: int = 13) -> VectorArray:
    grid = Grid((side,) * 3, (3 / (side - 1),) * 3, (-1.5,) * 3)
    return VectorArray(np.sin(np.pi * _places(grid)), grid)


def test_all_points_are_found_on_any_ranks(tmp_path: Path) -> None:
    """Sines along three axes vanish at 27 places, between samples at the ends of some ranks' cells and at samples."""
    for side in (13, 16):
        alone = find_critical_points(_waves(side))
        assert Counter(alone.types) == {"source": 1, "saddle 2": 6, "saddle 1": 12, "sink": 8}
        np.testing.assert_allclose(alone.positions, np.rint(alone.positions), atol=1e-6)
        for ranks in (2, 3, 5, 7):
            for one in run_loopback(ranks, lambda channel, side=side: find_critical_points(_waves(side), channel)):
                np.testing.assert_array_equal(one.positions, alone.positions)
                np.testing.assert_array_equal(one.eigenvalues, alone.eigenvalues)
                assert one.types == alone.types
    alone.write(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert tuple(head) == COLUMNS
    assert [row[3] for row in rows] == list(alone.types)
    np.testing.assert_array_equal(np.array([row[:3] for row in rows], float), alone.positions)
    assert "27 critical points; 12 saddle 1" in alone.summary


def test_two_points_in_one_cell_of_a_plane() -> None:
    x, y = np.meshgrid((0.0, 1.0), (0.0, 1.0))
    values = np.stack([x + y - 1, x * y - 0.21, 0 * x], axis=-1)[None]
    found = find_critical_points(VectorArray(values))
    np.testing.assert_allclose(np.sort(found.positions[:, :2], axis=0), [[0.3, 0.3], [0.7, 0.7]], atol=1e-9)
    assert sorted(found.types) == ["saddle", "source"]  # by hand: determinants −0.4 and 0.4, traces 1.3 and 1.7


def test_walls_and_regions_without_vectors_have_no_points() -> None:
    places = _places(Grid((6, 6, 6)))
    still = find_critical_points(VectorArray(np.ones((6, 6, 6, 3)) * places[..., 2:]))
    assert (still.types, still.degenerate_cells) == ((), 25)
    assert "25 cells without a direction" in still.summary
    holes = (places - 2.5) @ TURN.T
    holes[2, 2, 2] = np.nan
    assert find_critical_points(VectorArray(holes)).types == ()
