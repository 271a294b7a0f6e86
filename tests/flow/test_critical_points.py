"""Critical points: found once each, at the exact place, with the type of their Jacobian, on any ranks."""

from __future__ import annotations

import csv
import tracemalloc
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
    assert {row[-1] for row in rows} == {""}
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


def _still(side: int, ranges: list[tuple[slice, slice, slice]]) -> VectorArray:
    values = np.random.default_rng(5).normal(1.0, 0.1, (side, side, side, 3))
    for each in ranges:
        values[each] = 0
    return VectorArray(values, Grid((side,) * 3, (0.5, 0.5, 0.5), (1, 2, 3)))


def test_connected_samples_at_rest_are_one_region_and_no_points(tmp_path: Path) -> None:
    """A block of 27 samples, and a bar of 5 beside it: samples that touch at a corner alone are not connected."""
    block, bar = (slice(3, 6),) * 3, (slice(8, 9), slice(2, 7), slice(4, 5))
    corner = (slice(6, 7),) * 3
    vectors = _still(12, [block, bar, corner])
    alone = find_critical_points(vectors)
    # The sample at the corner is alone: the vectors vanish there, and nowhere around it.
    assert [(one.samples, one.middle) for one in alone.regions] == [(27, (3.0, 4.0, 5.0)), (5, (3.0, 4.0, 7.0))]
    np.testing.assert_allclose(alone.positions, [(4.0, 5.0, 6.0)], atol=1e-9)
    assert "1 critical points" in alone.summary
    assert "2 regions at rest" in alone.summary
    for ranks in (2, 3, 5, 7):
        for one in run_loopback(ranks, lambda channel: find_critical_points(vectors, channel)):
            assert one.rows == alone.rows
    alone.write(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert [(row[3], row[-1]) for row in rows[-2:]] == [("region at rest", "27"), ("region at rest", "5")]


def test_a_field_at_rest_takes_little_memory() -> None:
    """No box of a cell at rest is halved: 4096 boxes of each of 32768 cells took 12 GiB."""
    tracemalloc.start()
    found = find_critical_points(VectorArray(np.zeros((33, 33, 33, 3))))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (found.types, [one.samples for one in found.regions]) == ((), [33**3])
    assert peak < 100e6


def test_walls_of_a_box_are_one_region_around_the_point_inside() -> None:
    places = _places(Grid((9, 9, 9))) - 4
    inside = np.prod(16 - places**2, axis=-1, keepdims=True)  # 0 on the walls
    found = find_critical_points(VectorArray(inside * ((places - 0.3) @ TURN.T)))
    assert [one.samples for one in found.regions] == [9**3 - 7**3]
    assert found.types == ("spiral source",)


def test_vertices_at_rest_are_a_region() -> None:
    points, corners = _cube()
    still = make_cells(points, corners, np.where(points[:, 2:] == 0, 0.0, points + 1), False)
    found = find_critical_points(still)
    assert [(one.samples, one.middle) for one in found.regions] == [(4, (0.5, 0.5, 0.0))]
    assert found.types == ()
