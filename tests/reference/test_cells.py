"""The reference of unstructured grids: rays through corners and edges, and integrals against plain sums."""

from __future__ import annotations

import numpy as np
import pytest
from data.cells import lattice, mixed, one_cell, tetrahedra

from clusterviz.content.geometry.section import MeshSection
from clusterviz.content.grid.section import GridSection
from clusterviz.content.transfer import transfer_function
from clusterviz.data.geometry import Mesh
from clusterviz.data.source import Grid
from clusterviz.data.tetrahedra import Tetrahedra, make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.reference import render_reference
from clusterviz.reference.cells import PlacedCells, find_passages, march_cells, place_cells
from clusterviz.reference.fragments import Fragments
from clusterviz.reference.rays import Rays, camera_rays
from clusterviz.scene.transfer import TransferFunction
from clusterviz.scene.values import Camera, Clip, ImageSettings, Quality, Scene, Volume

PEAKS = ((0.0, 0.0), (2.0, 0.3), (3.0, 0.999), (3.05, 0.0), (4.0, 0.0), (5.0, 1.0), (6.0, 0.02))
COLOURS = ((0.0, 1.0, 0.2, 0.1), (2.5, 0.3, 0.9, 0.2), (6.0, 0.1, 0.2, 1.0))


def volume(opacity: float | tuple[tuple[float, float], ...] = PEAKS, unit: float = 0.7) -> Volume:
    colours = [tuple(point) for point in COLOURS]
    return Volume(path="a", cmap=colours, clim=(0.0, 6.0), opacity=opacity, opacity_unit_distance=unit)


def transfer(opacity: float | tuple[tuple[float, float], ...] = PEAKS, unit: float = 0.7) -> TransferFunction:
    return transfer_function(volume(opacity, unit))


def random_rays(count: int, low: float = 0.0, high: float = 1.0, seed: int = 1) -> Rays:
    """Rays from all around through points of a box."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(rng.uniform(low, high, (count, 3)) - 5 * high * direction, direction)


def summed(found: TransferFunction, scalars: np.ndarray, length: float) -> np.ndarray:
    """The picture of one segment in many small slabs: premultiplied RGBA."""
    depth = found.extinction(scalars) * length / len(scalars)
    before = np.exp(-np.append(0, np.cumsum(depth))[:-1])
    colour = (before * -np.expm1(-depth)) @ found.colour(scalars)
    return np.append(colour, -np.expm1(-depth.sum()))


@pytest.mark.parametrize("unit", [0.7, 0.01, 100.0])
def test_one_tetrahedron_against_a_sum_of_slabs(unit: float) -> None:
    cell, rays, look = tetrahedra(one_cell("tetra")), random_rays(20, high=0.4), transfer(unit=unit)
    found, passages = march_cells(rays, [PlacedCells(cell, look)]), find_passages(rays, cell)
    assert len(passages.ray) > 10
    assert sorted(passages.ray.tolist()) == sorted(set(passages.ray.tolist()))
    for ray, begin, end in zip(passages.ray, passages.begin, passages.end, strict=True):
        steps = begin + (end - begin) * (np.arange(60_000) + 0.5) / 60_000
        points = rays.start[ray] + steps[:, None] * rays.direction[ray]
        assert points.min() > -1e-12
        assert points.sum(axis=1).max() < 1 + 1e-12
        expected = summed(look, points @ [1.0, 2.0, 3.0], end - begin)
        np.testing.assert_allclose(found[ray], expected, rtol=0, atol=1e-7)
    assert (found[np.setdiff1d(np.arange(20), passages.ray)] == 0).all()


def check_cover(rays: Rays, cells: Tetrahedra, begin: np.ndarray, end: np.ndarray) -> None:
    """Passages of each ray follow one another without gaps from `begin` to `end`, each tetrahedron at most once."""
    found = find_passages(rays, cells)
    order = np.lexsort((found.begin + found.end, found.ray))
    ray, t0, t1 = found.ray[order], found.begin[order], found.end[order]
    pairs = np.stack([found.ray, found.tetrahedron], axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    joined = ray[1:] == ray[:-1]
    rounding = 1e-14 * np.abs(rays.start).max() * (rays.direction**2).sum(axis=1).max(initial=1)
    np.testing.assert_allclose(t0[1:][joined], t1[:-1][joined], rtol=0, atol=rounding)
    lengths = np.bincount(ray, t1 - t0, minlength=len(rays.direction))
    np.testing.assert_allclose(lengths, end - begin, rtol=0, atol=10 * rounding)


@pytest.mark.cover
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("tilt", [(0, 0, 1), (1, 0, 1), (1, 1, 1), (1, 2, 4)])
def test_rays_through_every_corner_and_edge_are_covered_once(tilt: tuple[int, int, int], scale: float) -> None:
    """All rays in one of these directions through the corners, and the middles of all edges, of a cube of 2³ cells."""
    cells = tetrahedra(lattice(2, 2, 2, spacing=scale))
    points, corners = cells.points, cells.corners.astype(int)
    middles = [(points[corners[:, a]] + points[corners[:, b]]) / 2 for a in range(4) for b in range(a)]
    through = np.concatenate([points, *middles])
    way = np.array(tilt, float)
    # The start is exact; the direction need not be of unit length for the walk, as lengths scale with it.
    rays = Rays(through - 8 * scale * way, np.broadcast_to(way, through.shape).copy())
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = -rays.start / way, (2 * scale - rays.start) / way
    # On a face of the cube the rule decides; there it is the lower one along each axis that holds the ray moved by ε.
    near, far = np.where(way > 0, near, -np.inf).max(axis=1), np.where(way > 0, far, np.inf).min(axis=1)
    inside = far > near
    for axis in range(3):
        if way[axis] == 0:
            inside &= (through[:, axis] >= 0) & (through[:, axis] < 2 * scale)
    factor = np.linalg.norm(way) ** 2
    check_cover(rays, cells, np.where(inside, near, 0) * factor, np.where(inside, far, 0) * factor)


def test_other_grids_are_covered_once() -> None:
    """Slivers, holes, parts without contact, and a grid of all kinds of cells, by the volume of what rays pass."""
    thin = lattice(2, 2, 2)
    cells = tetrahedra(UnstructuredGrid("thin", thin.points * [1, 1, 1e-6], thin.cells, thin.point_arrays))
    rays = random_rays(200, high=2.0, seed=3)
    start = rays.start * [1, 1, 1e-6]
    way = rays.direction * [1, 1, 1e-6]
    near = np.maximum.reduce(
        [np.minimum(-s / w, (e - s) / w) for s, w, e in zip(start.T, way.T, (2, 2, 2e-6), strict=True)]
    )
    far = np.minimum.reduce(
        [np.maximum(-s / w, (e - s) / w) for s, w, e in zip(start.T, way.T, (2, 2, 2e-6), strict=True)]
    )
    unit = np.linalg.norm(way, axis=1)
    hit = far > near
    check_cover(Rays(start, way / unit[:, None]), cells, np.where(hit, near * unit, 0), np.where(hit, far * unit, 0))
    whole = lattice(3, 3, 3)
    hexes = whole.cells["hexahedron"]
    centres = whole.points[hexes].mean(axis=1)
    hollow = ~(np.abs(centres - 1.5).max(axis=1) < 1)
    cells = tetrahedra(UnstructuredGrid("hollow", whole.points, {"hexahedron": hexes[hollow]}, whole.point_arrays))
    x = np.array([0.3, 1.2, 1.7, 2.9])
    rays = Rays(np.stack([x, x[::-1], 0 * x - 4], axis=1), np.broadcast_to([0.0, 0, 1], (4, 3)).copy())
    passed = find_passages(rays, cells)
    lengths = np.bincount(passed.ray, passed.end - passed.begin)
    np.testing.assert_allclose(lengths, [3, 2, 2, 3], atol=1e-12)
    both = find_passages(random_rays(300, high=2.0), tetrahedra(mixed()))
    assert len(np.unique(np.stack([both.ray, both.tetrahedron]), axis=1).T) == len(both.ray) > 100


AXIS = Camera(position=(9.0, -7.0, 6.0), focal_point=(2.0, 2.0, 2.0), view_up=(0, 0, 1), view_angle=30)


def scene(look: Volume, camera: Camera = AXIS, size: tuple[int, int] = (9, 7)) -> Scene:
    return Scene(volumes=(look,), camera=camera, image=ImageSettings(size=size), quality=Quality(step=1.0))


def test_a_linear_field_is_the_limit_of_the_volume_renderer() -> None:
    """The error of the volume's midpoints falls with the square of the step towards the grid's picture."""
    cells, look = tetrahedra(lattice(4, 4, 4, field=lambda p: p @ [0.3, 0.5, 0.7])), volume(((0, 0.1), (6, 0.8)))
    k, j, i = np.indices((5, 5, 5))
    whole = scene(look)
    exact = march_cells(camera_rays(AXIS, (9, 7)), [PlacedCells(cells, transfer_function(look))])
    assert exact[:, 3].max() > 0.9
    errors = []
    for step in (0.2, 0.05):
        found = render_reference(whole, Grid((5, 5, 5)), 0.3 * i + 0.5 * j + 0.7 * k, step)
        errors.append(np.sqrt(((found.reshape(-1, 4) - exact) ** 2).mean()))
    assert errors[1] < 2e-4
    assert errors[0] / errors[1] > 8


def test_a_smooth_field_comes_near_the_volume_with_the_square_of_the_cell() -> None:
    look, errors = volume(((0, 0.0), (6, 0.6))), []
    for n in (4, 8, 16):
        field = lambda p: 3 + 2 * np.sin(p[:, 0]) * np.cos(1.3 * p[:, 1]) + p[:, 2] / 2  # noqa: E731
        cells = tetrahedra(lattice(n, n, n, field=field, spacing=4 / n))
        rays = camera_rays(AXIS, (6, 5))
        k, j, i = np.indices((n + 1,) * 3) * (4 / n)
        voxels = field(np.stack([i, j, k], axis=-1).reshape(-1, 3)).reshape(k.shape)
        spacing = (4 / n,) * 3
        limit = render_reference(scene(look, size=(6, 5)), Grid(k.shape, spacing), voxels, 0.02 * n / 4)
        found = march_cells(rays, [PlacedCells(cells, transfer_function(look))])
        errors.append(np.abs(limit.reshape(-1, 4) - found).max())
    assert errors[0] / errors[1] > 2.5
    assert errors[1] / errors[2] > 2.5


def test_grids_mix_and_tetrahedra_that_overlap_add_up() -> None:
    cells, rays = tetrahedra(lattice(2, 2, 2)), random_rays(30, high=2.0)
    once, twice = (PlacedCells(cells, transfer(0.4, unit)) for unit in (1.0, 0.5))
    np.testing.assert_allclose(march_cells(rays, [once, once]), march_cells(rays, [twice]), atol=1e-12)
    beside = Tetrahedra("b", cells.points + np.array([2, 0, 0]), cells.corners, cells.values, False, cells.cells)
    apart = march_cells(rays, [once, PlacedCells(beside, transfer(0.4))])
    np.testing.assert_allclose(apart, march_cells(rays, [PlacedCells(beside, transfer(0.4)), once]), atol=1e-12)


def test_arrays_of_cells_are_constant() -> None:
    grid = mixed()
    rays = Rays(np.array([[0.4, 0.3, -3.0]]), np.array([[0.0, 0.0, 1.0]]))
    passed = find_passages(rays, make_tetrahedra(grid, "kind"))
    lengths = {value: (passed.end - passed.begin)[passed.front == value].sum() for value in set(passed.front)}
    assert lengths.keys() == {5, 8}  # the pyramid, 1 high over (0.5, 0.25), stands on the hexahedron
    assert (passed.front == passed.back).all()
    assert lengths[8] == pytest.approx(1)
    assert lengths[5] == pytest.approx(0.8)


def test_clips_cut_and_fragments_lie_between() -> None:
    cells = tetrahedra(lattice(2, 2, 2, field=lambda p: np.ones(len(p))))
    rays = Rays(np.array([[0.6, 0.7, -1.0]]), np.array([[0.0, 0.0, 1.0]]))
    look = PlacedCells(cells, transfer(0.5, 1.0))
    clip = Clip(planes=(((0.0, 0.0, 0.25), (0.0, 0.0, 1.0)),), box=(0.0, 2.0, 0.0, 2.0, 0.0, 1.5))
    assert march_cells(rays, [look], clip)[0, 3] == pytest.approx(1 - 0.5**1.25, abs=1e-14)
    inside = Rays(np.array([[0.6, 0.7, 0.5]]), rays.direction)
    assert march_cells(inside, [look])[0, 3] == pytest.approx(1 - 0.5**1.5, abs=1e-14)
    green = np.array([[0.0, 1.0, 0.0, 1.0]])
    solid = Fragments(np.array([0, 1]), np.array([1.75]), green, np.zeros(1, int), np.zeros((1, 3)))
    found = march_cells(rays, [look], fragments=solid)[0]
    colour = look.transfer.colour(np.array(1.0))
    front = 1 - 0.5**0.75
    np.testing.assert_allclose(found, [*(front * colour + (1 - front) * np.array([0, 1, 0])), 1], atol=1e-14)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_transforms_place_grids_and_may_reflect(sign: float) -> None:
    matrix = ((2.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 3.0 * sign, 5.0), (0.0, 0.0, 0.0, 1.0))
    section = GridSection(path="a", transform=matrix, clim=(0, 4), opacity=0.5, opacity_unit_distance=1.0)
    placed = place_cells(section, lattice(1, 1, 1))
    rays = Rays(np.array([[1.6, 0.7, -9.0]]), np.array([[0.0, 0.0, 1.0]]))
    passed = find_passages(rays, placed.tetrahedra)
    assert (passed.begin.min() - 9, passed.end.max() - 9) == pytest.approx((5, 8) if sign > 0 else (2, 5))
    assert march_cells(rays, [placed])[0, 3] == pytest.approx(1 - 0.5**3, abs=1e-12)


def test_volumes_and_meshes_mix_with_grids() -> None:
    """A constant grid in a constant volume adds its extinction; a mesh and an isosurface hide what is behind them."""
    flat = Volume(path="a", cmap="gray", clim=(0, 1), opacity=0.3, opacity_unit_distance=1.0)
    camera = Camera(position=(2.1, 2.2, -9), focal_point=(2.1, 2.2, 0), view_up=(0, 1, 0), parallel_scale=1e-6)
    whole, voxels = scene(flat, camera, (1, 1)), np.ones((5, 5, 5))
    cells = tetrahedra(lattice(2, 2, 2, field=lambda p: np.full(len(p), 3.0)))
    cells = Tetrahedra("a", cells.points + 1, cells.corners, cells.values, False, cells.cells)
    look = PlacedCells(cells, transfer(0.4, 1.0))
    found = render_reference(whole, Grid((5, 5, 5)), voxels, 0.7, cells=[look])[0, 0]
    assert found[3] == pytest.approx(1 - 0.7**4 * 0.6**2, abs=1e-12)
    kappa, colours = -np.log([0.7, 0.6]), np.stack([np.ones(3), look.transfer.colour(np.array(3.0))])
    outer = (1 - 0.7) * colours[0]
    mixture = (1 - 0.42**2) * (kappa @ colours) / kappa.sum()
    np.testing.assert_allclose(found[:3], outer + 0.7 * (mixture + 0.42**2 * outer), atol=1e-12)
    square = np.array([(0, 0, 2), (9, 0, 2), (0, 9, 2)], float)
    mesh = MeshSection(path="m", color="red", shade=False), Mesh("m", square, np.array([[0, 1, 2]]))
    found = render_reference(whole, Grid((5, 5, 5)), voxels, 0.7, geometry=[mesh], cells=[look])[0, 0]
    front = outer + 0.7 * (1 - 0.42) * (kappa @ colours) / kappa.sum()
    np.testing.assert_allclose(found, [*(front + 0.7 * 0.42 * np.array([1, 0, 0])), 1], atol=1e-12)
    ramp = np.broadcast_to(np.arange(5.0)[:, None, None], (5, 5, 5))
    solid = flat.model_copy(update={"isosurfaces": ((2.0, 1.0),), "clim": (0.0, 0.1)})
    cut = render_reference(scene(solid, camera, (1, 1)), Grid((5, 5, 5)), ramp, 0.7, cells=[look])[0, 0]
    np.testing.assert_allclose(cut, [*(front + 0.7 * 0.42), 1], atol=1e-9)
    alone = render_reference(Scene(camera=camera, image=ImageSettings(size=(1, 1))), [], [], cells=[look])[0, 0]
    assert alone[3] == pytest.approx(1 - 0.36, abs=1e-12)


def test_no_cells_and_no_rays_are_transparent() -> None:
    empty = UnstructuredGrid("none", np.zeros((0, 3)), {"tetra": np.zeros((0, 4), int)}, {"f": np.zeros(0)})
    assert (march_cells(random_rays(5), [PlacedCells(tetrahedra(empty), transfer())]) == 0).all()
    assert march_cells(Rays(np.zeros((0, 3)), np.zeros((0, 3))), []).shape == (0, 4)
