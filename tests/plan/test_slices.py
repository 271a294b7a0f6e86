"""Slice generators: the same polygons from each, watertight, and exact where planes hit corners, edges and faces."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from clusterviz.plan.slices import GENERATORS
from clusterviz.plan.slices.brute_force import brute_force
from clusterviz.plan.slices.contract import FAR, Cuts, Polygons
from clusterviz.plan.slices.marching_cubes_table import COUNTS, marching_cubes_table
from clusterviz.plan.slices.vertex_shader import choose_edges

MANY, CHUNK = 1_000_000, 8_000


def random_cuts(count: int, seed: int = 1) -> Cuts:
    """Boxes of any shape, and planes of any direction that meet most of them."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(-10, 10, (count, 3))
    high = low + rng.uniform(0.01, 8, (count, 3))
    normal = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-3, 1, (count, 1))
    levels = Cuts(low, high, normal, np.zeros(count)).corner_levels
    share = rng.uniform(-0.05, 1.05, count)
    return Cuts(low, high, normal, levels[:, 0] * (1 - share) + levels[:, 7] * share)


def lattice_cuts() -> Cuts:
    """A box of integers, cut by all planes of small directions that hit one of its corners or edges' middles."""
    low, high = np.array([1.0, -2.0, 3.0]), np.array([3.0, 2.0, 4.0])
    directions = np.array([each for each in product((-2, -1, 0, 1, 2), repeat=3) if any(each)], float)
    points = np.array(list(product(*([a, (a + b) / 2, b] for a, b in zip(low, high, strict=True)))))
    normal, point = np.repeat(directions, len(points), axis=0), np.tile(points, (len(directions), 1))
    return Cuts(np.tile(low, (len(point), 1)), np.tile(high, (len(point), 1)), normal, (normal * point).sum(axis=1))


def parts_of(cuts: Cuts, share: float) -> list[Cuts]:
    """The same planes in the eight boxes into which three planes divide each box."""
    middle = cuts.low + share * (cuts.high - cuts.low)
    return [
        Cuts(np.where(far, middle, cuts.low), np.where(far, cuts.high, middle), cuts.normal, cuts.level) for far in FAR
    ]


def on_face(polygons: Polygons, axis: int, at: np.ndarray) -> np.ndarray:
    """Least and greatest coordinates of each polygon's vertices on the plane x[axis] = at, (2, 3, n)."""
    vertices = np.ascontiguousarray(polygons.vertices.T)  # reduced along the first axis, which is faster
    there = (vertices[axis] == at) & (polygons.counts > 0)
    return np.array(
        [reduce(np.where(there, vertices, fill), axis=1) for reduce, fill in ((np.min, np.inf), (np.max, -np.inf))]
    )


@pytest.mark.long
def test_the_pieces_of_a_million_slices_fit_together() -> None:
    """Two boxes with a common face have the same vertices on it, bit for bit, and together the area of the whole."""
    shared = 0
    for seed in range(MANY // CHUNK):
        cuts, axis = random_cuts(CHUNK, seed), seed % 3
        at = cuts.low[:, axis] + 0.3 * (cuts.high[:, axis] - cuts.low[:, axis])
        begin, end = cuts.low.copy(), cuts.high.copy()
        begin[:, axis] = end[:, axis] = at
        left = marching_cubes_table(Cuts(cuts.low, end, cuts.normal, cuts.level))
        right = marching_cubes_table(Cuts(begin, cuts.high, cuts.normal, cuts.level))
        ends = on_face(left, axis, at)
        shared += np.isfinite(ends[0, 0]).sum()
        assert np.array_equal(ends, on_face(right, axis, at))
        if seed < 9:
            away = np.abs(left.areas + right.areas - marching_cubes_table(cuts).areas)
            assert (away <= 1e-12 * ((cuts.high - cuts.low) ** 2).sum(axis=1)).all()
    assert shared > MANY / 3


@pytest.mark.parametrize("name", GENERATORS)
def test_all_generators_give_the_same_polygons(name: str) -> None:
    cuts = random_cuts(20_000)
    found, expected = GENERATORS[name](cuts), marching_cubes_table(cuts)
    size = np.linalg.norm(cuts.high - cuts.low, axis=1)
    assert ((found.counts > 0) == (expected.counts > 0)).all()
    assert (np.abs(found.areas - expected.areas) <= 1e-11 * size**2).all()
    cut = expected.counts > 0
    apart = np.linalg.norm(found.vertices[cut, :, None] - expected.vertices[cut, None], axis=3) / size[cut, None, None]
    assert apart.min(axis=1).max() <= 1e-9  # of edges that are almost parallel to the plane
    assert apart.min(axis=2).max() <= 1e-9


def test_areas_are_those_of_the_section() -> None:
    """The second derivative of the volume in front of a plane, by the eight corners."""
    cuts = random_cuts(5_000)
    steep = (np.abs(cuts.normal) > 0.2 * np.linalg.norm(cuts.normal, axis=1, keepdims=True)).all(axis=1)
    signs = np.where(FAR.sum(axis=1) % 2, -1.0, 1.0)
    passed = np.maximum(cuts.level[:, None] - cuts.corner_levels, 0.0)
    area = (signs * passed**2).sum(axis=1) * np.linalg.norm(cuts.normal, axis=1) / np.abs(2 * cuts.normal.prod(axis=1))
    area = np.where(cuts.level < cuts.corner_levels[:, 7], area, 0.0)
    assert steep.sum() > 1_000
    assert np.allclose(marching_cubes_table(cuts).areas[steep], area[steep], rtol=1e-9, atol=1e-9)


def face_cuts(count: int) -> Cuts:
    """Boxes of any shape, and planes in their faces."""
    cuts, rng = random_cuts(count, 7), np.random.default_rng(8)
    rows, normal = np.arange(count), np.zeros((count, 3))
    normal[rows, rng.integers(3, size=count)] = rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-3, 1, count)
    levels = Cuts(cuts.low, cuts.high, normal, np.zeros(count)).corner_levels
    return Cuts(cuts.low, cuts.high, normal, levels[rows, rng.choice([0, 7], count)])


@pytest.mark.parametrize("name", GENERATORS)
def test_planes_in_faces_of_any_box_show_the_near_one(name: str) -> None:
    cuts = face_cuts(20_000)
    found, expected = GENERATORS[name](cuts), marching_cubes_table(cuts)
    assert 9_000 < np.count_nonzero(expected.counts) < 11_000
    assert ((found.counts > 0) == (expected.counts > 0)).all()
    size = np.linalg.norm(cuts.high - cuts.low, axis=1)
    assert (np.abs(found.areas - expected.areas) <= 1e-11 * size**2).all()


@pytest.mark.parametrize("name", GENERATORS)
def test_planes_through_corners_edges_and_faces_are_exact(name: str) -> None:
    """A corner that is hit is a vertex, to the last bit but of clipped polygons; of boxes at a face one has it."""
    cuts = lattice_cuts()
    whole = GENERATORS[name](cuts)
    hit = (cuts.corner_levels == cuts.level[:, None]) & (whole.counts > 0)[:, None]
    corners = np.where(FAR, cuts.far[:, None], cuts.near[:, None])
    away = np.abs(whole.vertices[:, None] - corners[:, :, None]).max(axis=3).min(axis=2)
    assert hit.sum() > 1_000
    assert away[hit].max() <= (1e-14 if name == "vertex-array-template" else 0.0)
    pieces = sum(GENERATORS[name](part).areas for part in parts_of(cuts, 0.5))
    # In the box's own far face, the polygon is that of a box behind it.
    assert np.allclose(pieces, whole.areas, rtol=1e-13, atol=1e-13)
    flat = (cuts.normal != 0).sum(axis=1) == 1
    assert (whole.counts[flat] > 0).sum() * 3 == flat.sum() * 2


def test_lines_by_themselves_give_wrong_polygons_and_corners_do_not() -> None:
    """The failure of brute force that the thesis reports, where a plane hits a corner, and beside one by rounding."""
    lattice = lattice_cuts()
    right, wrong = brute_force(lattice).areas, brute_force(lattice, by_lines=True).areas
    assert (np.abs(wrong - right) > 0.1).mean() > 0.05
    # Levels that differ by the last bits from those of a corner.
    close = random_cuts(50_000)
    levels = close.corner_levels[:, 3]
    close = Cuts(
        close.low,
        close.high,
        close.normal,
        levels * (1 + np.random.default_rng(2).integers(-1, 2, levels.shape) * 2.0**-52),
    )
    differs = brute_force(close, by_lines=True).counts != brute_force(close).counts
    assert differs.sum() > 100
    assert np.allclose(brute_force(close).areas, marching_cubes_table(close).areas, rtol=1e-12, atol=1e-12)


def test_vertices_try_as_many_edges_as_the_thesis_says() -> None:
    cuts = random_cuts(20_000)
    met = marching_cubes_table(cuts).counts > 0
    tried, before = (choose_edges(cuts, in_order_of_1)[1][met].sum(axis=1) for in_order_of_1 in (False, True))
    assert (tried.min(), tried.max(), before.max()) == (9, 15, 21)
    assert set(COUNTS.tolist()) == {0, 3, 4, 5, 6}
    assert np.count_nonzero(COUNTS) == 18  # of the 20 sets that hold, with a corner, the nearer ones: not none, not all
