"""Unstructured grids, against the float64 reference: alone, with geometry and volumes, in any parts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import moderngl
import numpy as np
import pytest
from data.cells import lattice, mixed
from render import scenes
from render.scenes import Prepared

from clusterviz.comm import LoopbackChannel
from clusterviz.content.geometry.section import MeshSection
from clusterviz.content.grid.section import GridSection, KBuffer
from clusterviz.data.faces import find_neighbours
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.tetrahedra import make_tetrahedra
from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.frame import Options, Run, prepare
from clusterviz.pages.kbuffer.analysis import analyse, comparisons
from clusterviz.reference import render_reference
from clusterviz.reference.cells import find_passages, place_cells
from clusterviz.reference.rays import camera_rays
from clusterviz.render import opengl
from clusterviz.render.abuffer import primitives
from clusterviz.render.cells.table import LocalGrid, make_local_grid
from clusterviz.render.march import March
from clusterviz.render.opengl import opengl_caster
from clusterviz.scene.values import Camera, Clip, Cluster, ImageSettings, Light, Quality, Scene, Volume

CAMERAS = {
    "outside": Camera(position=(22, 17, 14), focal_point=(3, 3, 3), view_up=(0, 0, 1)),
    "inside": Camera(position=(3.2, 2.7, 2.9), focal_point=(5, 6, 4), view_up=(0, 0, 1), view_angle=90),
    "parallel": Camera(position=(22, -17, 14), focal_point=(3, 3, 3), view_up=(0, 0, 1), parallel_scale=5),
    "along edges": Camera(position=(3, 3, -20), focal_point=(3, 3, 3), view_up=(0, 1, 0), view_angle=20),
    "long": Camera(position=(80, -60, 10), focal_point=(3, 3, 24), view_up=(0, 0, 1), view_angle=30),
    "far": Camera(position=(3e6, 3e6, 4e6), focal_point=(3, 3, 3), view_up=(0, 0, 1), view_angle=1.5e-4),
}


def waves(points: np.ndarray) -> np.ndarray:
    x, y, z = points.T
    return 0.5 + 0.2 * np.sin(1.3 * x + 0.4 * y) + 0.2 * np.cos(1.1 * z - 0.7 * y) + 0.1 * np.sin(2.1 * y)


def slow_waves(points: np.ndarray) -> np.ndarray:
    return waves(points / 2)


def without(grid: UnstructuredGrid, share: float) -> UnstructuredGrid:
    """The grid with holes."""
    kept = np.random.default_rng(5).random(len(grid.cells["hexahedron"])) >= share
    return replace(grid, cells={"hexahedron": grid.cells["hexahedron"][kept]})


def layered(grid: UnstructuredGrid) -> UnstructuredGrid:
    """The grid with every second layer a million times thinner than wide."""
    moved = grid.points.copy()
    moved[:, 2] = moved[:, 2] // 2 + 1e-6 * (moved[:, 2] % 2)
    return replace(grid, points=moved, point_arrays={"f": waves(moved)})


def bent(grid: UnstructuredGrid, shift: tuple[float, float, float] = (0, 0, 0)) -> UnstructuredGrid:
    """The grid with corners nowhere in particular."""
    moved = grid.points + 0.2 * np.random.default_rng(6).uniform(-1, 1, grid.points.shape) + shift
    return replace(grid, points=moved, point_arrays={"f": waves(moved)})


LATTICE = lattice(6, 6, 6, field=waves)
HOLES = bent(without(lattice(7, 6, 6, field=waves), 0.3))
SLIVERS = layered(lattice(11, 5, 5, field=waves))
BESIDE = bent(without(lattice(5, 5, 5, field=waves), 0.1), (2.6, 2.3, 1.4))
CELLS = replace(mixed(), point_arrays={}, points=3 * mixed().points)
NUMBERED = replace(
    HOLES, point_arrays={}, cell_arrays={"kind": 3 + np.arange(len(HOLES.cells["hexahedron"])) * 1.7 % 6}
)
LOOK: dict[str, Any] = {"path": "g", "clim": (0.0, 1.0), "opacity_unit_distance": 2.0}
THIN = GridSection(**LOOK, cmap=((0.0, 1, 0, 0), (0.5, 0, 1, 0.2), (1.0, 0, 0.3, 1)), opacity=((0.1, 0), (0.9, 0.8)))
PEAKS = GridSection(**LOOK, cmap="inferno", opacity=((0.3, 0), (0.35, 0.9), (0.4, 0), (0.6, 0), (0.7, 0.7), (0.8, 0)))
DEEP = THIN.model_copy(update={"opacity_unit_distance": 0.1})
NARROW = GridSection(
    **LOOK,
    cmap="inferno",
    opacity=tuple((s + d, 0.9 * (d == 0)) for s in (0.3, 0.4, 0.5, 0.6, 0.7) for d in (-0.005, 0, 0.005)),
)
OF_CELLS = GridSection(path="g", array="kind", clim=(3.0, 9.0), opacity=((3, 0.2), (9, 0.6)), opacity_unit_distance=2.0)
MIRROR = {"transform": ((-1, 0.2, 0, 6), (0, 1, 0, 0), (0, 0, 1.1, 0), (0, 0, 0, 1))}
MIRRORED = THIN.model_copy(update=MIRROR)
LIT = THIN.model_copy(update={"shade": True, "ambient": 0.2, "diffuse": 0.7, "specular": 0.1, "specular_power": 12.0})
LIGHTS = Light(position=(3, 1, 2), color=(1, 0.5, 0.2)), Light(type="headlight", color=(0.1, 0.3, 0.5))
LAMP = Light(position=(30, 20, 25), focal_point=(3, 3, 3), positional=True, cone_angle=90, color=(0.3, 0.3, 0.3))
NOISE = scenes.smooth((9, 8, 10))
VOLUME = (
    Volume(path="v", clim=(0.0, 1.0), opacity=((0.2, 0), (1.0, 0.5)), cmap="gray", opacity_unit_distance=2.0),
    NOISE,
    Grid(NOISE.shape, (0.8, 0.8, 0.8), (1, 0, -1)),
)
PLANES = Mesh(
    "m", np.array([[-2, 9, 2], [9, -2, 3], [3, 3, 9], [8, 8, -1]], np.float32), np.array([[0, 1, 2], [0, 1, 3]])
)
MESH = (MeshSection(path="m", color="red", opacity=0.5, shade=False), PLANES)
CUT = {"clip": Clip(planes=(((3, 3, 3), (0.2, 1, 1)),))}
Entry = tuple[GridSection, UnstructuredGrid]


def prepared(scene: Scene, grids: tuple[Entry, ...], volumes: tuple[Any, ...], meshes: tuple[Any, ...]) -> Prepared:
    sources = [ArraySource(one[1], one[2]) for one in volumes]
    given = [Geometry(mesh=mesh) for _, mesh in meshes]
    share, bricks = prepare(Run(LoopbackChannel(), Options()), scene, [*sources, *given, *(grid for _, grid in grids)])
    assert share.plan is not None
    return Prepared(share.plan, bricks)


def scene_of(
    grids: tuple[Entry, ...], camera: str, volumes: tuple[Any, ...] = (), meshes: tuple[Any, ...] = (), **keys: Any
) -> Scene:
    brick, step = keys.pop("brick", 64), keys.pop("step", 0.7)
    return Scene(
        volumes=tuple(one[0] for one in volumes),
        meshes=tuple(one[0] for one in meshes),
        grids=tuple(one[0] for one in grids),
        camera=CAMERAS[camera],
        image=ImageSettings(size=(36, 28)),
        quality=Quality(step=step),
        cluster=Cluster(brick=brick),
        **keys,
    )


def expected(scene: Scene, grids: tuple[Entry, ...], volumes: tuple[Any, ...], meshes: tuple[Any, ...]) -> np.ndarray:
    cells = [place_cells(*pair) for pair in grids]
    parts = [one[2] for one in volumes], [one[1] for one in volumes]
    return render_reference(scene, *parts, geometry=meshes, cells=cells)


MIXTURE = "volume, geometry, and two, one lit"
VIEWS = tuple(name for name in CAMERAS if name != "long")
CASES: dict[str, tuple[Any, ...]] = {
    "lattice": (((THIN, LATTICE),), (), (), {}, VIEWS, 1e-5),
    "holes": (((THIN, HOLES),), (), (), {}, VIEWS, 1e-5),
    "peaks": (((PEAKS, HOLES),), (), (), {}, ("outside",), 1e-5),
    "narrow peaks": (((NARROW, HOLES),), (), (), {}, ("outside",), 1e-4),
    "deep": (((DEEP, HOLES),), (), (), {}, ("outside",), 1e-4),
    "slivers": (((THIN, SLIVERS),), (), (), {}, ("outside", "inside"), 1e-5),
    "arrays of cells": (((OF_CELLS, CELLS),), (), (), {}, ("outside", "inside"), 1e-5),
    "cells with holes": (((OF_CELLS, NUMBERED),), (), (), {}, ("outside",), 1e-5),
    "mirrored": (((MIRRORED, HOLES),), (), (), {}, ("outside",), 1e-5),
    "clipped": (((THIN, HOLES),), (), (), CUT, ("outside", "inside"), 1e-5),
    "geometry": (((THIN, HOLES),), (), (MESH,), {}, ("outside", "inside"), 1e-5),
    "volume": (((THIN, HOLES),), (VOLUME,), (), {"step": 0.1}, ("outside", "inside"), 1e-4),
    MIXTURE: (((LIT, HOLES), (PEAKS, BESIDE)), (VOLUME,), (MESH,), {"step": 0.1, "lights": LIGHTS}, ("outside",), 1e-4),
    "two, one lit": (((LIT, HOLES), (PEAKS, BESIDE)), (), (), {"lights": LIGHTS}, ("outside", "inside"), 1e-5),
    "mirrored, lit": (((LIT.model_copy(update=MIRROR), HOLES),), (), (), {"lights": LIGHTS}, ("outside",), 1e-5),
    "a lamp": (((LIT, HOLES),), (), (), {"lights": (*LIGHTS, LAMP)}, ("outside",), 2e-3),
}


@pytest.mark.cover(
    "two, one lit-inside",
    "volume, geometry, and two, one lit-outside",
    "geometry-outside",
    "volume-outside",
    "two, one lit-outside",
)
@pytest.mark.parametrize(("name", "camera"), [(name, camera) for name in CASES for camera in CASES[name][4]])
def test_pictures_are_the_reference(name: str, camera: str) -> None:
    grids, volumes, meshes, keys, _, bound = CASES[name]
    scene = scene_of(grids, camera, volumes, meshes, **keys)
    right = expected(scene, grids, volumes, meshes)
    found = scenes.drawn(None, prepared(scene, grids, volumes, meshes))[0]
    assert right[..., 3].max() > 0.2
    assert np.abs(found - right).max() <= bound


ON_OPENGL = [("holes", "outside"), ("holes", "inside"), ("cells with holes", "outside"), (MIXTURE, "outside")]
"""All but the mixture are drawn by one program: Mesa compiles for much longer than it draws."""


@pytest.mark.cover("volume, geometry, and two, one lit-outside")
@pytest.mark.gl
@pytest.mark.parametrize(("name", "camera"), ON_OPENGL)
def test_opengl_draws_what_cpus_draw(name: str, camera: str, context: moderngl.Context) -> None:
    grids, volumes, meshes, keys, _, bound = CASES[name]
    scene = scene_of(grids, camera, volumes, meshes, **keys)
    given = prepared(scene, grids, volumes, meshes)
    found = scenes.drawn(context, given)[0]
    assert np.abs(found - scenes.drawn(None, given)[0]).max() <= 3e-6
    assert np.abs(found - expected(scene, grids, volumes, meshes)).max() <= bound


@pytest.mark.cover("volume, geometry, and two, one lit")
@pytest.mark.gl
def test_the_rasteriser_finds_the_entries_of_tile_lists(context: moderngl.Context) -> None:
    """Before and behind the eye, at edges, and of mirrored cells."""
    caster = None
    for camera, section in ((camera, section) for section in (THIN, MIRRORED) for camera in CAMERAS):
        given = prepared(scene_of(((section, HOLES),), camera), ((section, HOLES),), (), ())
        (right,) = scenes.draw_pieces(None, given, scenes.pieces_of(given, 1))[0]
        caster = caster or opengl_caster(context, given.plan, raster=True)
        caster.drop(given.bricks)
        caster.load(given.plan, given.shown)
        (found,) = caster.draw(given.plan, scenes.pieces_of(given, 1))
        assert right.fragments.any()
        assert np.array_equal(found.fragments, right.fragments), camera
        assert np.abs(found.partial.rgba - right.partial.rgba).max() <= 3e-6, camera
    assert caster
    caster.release()


@pytest.mark.gl
@pytest.mark.parametrize("name", ["holes", pytest.param(MIXTURE, marks=pytest.mark.long)])
def test_dispatches_may_end_within_a_walk(
    name: str, context: moderngl.Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the programs of the test above, with a few steps of a ray in each dispatch."""
    grids, volumes, meshes, keys, _, _ = CASES[name]
    given = prepared(scene_of(grids, "outside", volumes, meshes, **keys), grids, volumes, meshes)
    monkeypatch.setattr(opengl, "ITERATIONS", (20, 20))
    ended, end_turn = [0], March._end_turn

    def counted(self: March, *given: Any, **named: Any) -> Any:
        found = end_turn(self, *given, **named)
        ended[0] += found[0] is not None
        return found

    monkeypatch.setattr(March, "_end_turn", counted)
    (found, count), (on_cpu, own_count) = (scenes.drawn(where, given) for where in (context, None))
    assert ended[0] > 4
    assert np.abs(found - on_cpu).max() <= 3e-6
    assert count == own_count or volumes  # a slab that goes on in another dispatch counts twice


@pytest.mark.parametrize("where", ["cpu", pytest.param("opengl", marks=pytest.mark.gl)])
def test_walks_in_circles_end_and_are_counted(
    where: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind all faces of each inner tetrahedron is itself again, as if slivers were folded."""

    def folded(*given: Any) -> LocalGrid:
        grid = make_local_grid(*given)
        own = np.arange(grid.following.size, dtype=np.int32).reshape(-1, 4)
        is_inner = (grid.following >= 0).all(axis=1, keepdims=True)
        return replace(grid, following=np.where(is_inner, own, grid.following))

    monkeypatch.setattr(primitives, "make_local_grid", folded)
    given = prepared(scene_of(((THIN, HOLES),), "outside"), ((THIN, HOLES),), (), ())
    found = scenes.draw(None if where == "cpu" else request.getfixturevalue("context"), given)
    assert found.cut_short > 100
    assert np.isfinite(found.partial.rgba).all()


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_do_not_change_the_picture(scale: float) -> None:
    # Hexahedra are cut by the digits of their corners.
    cells = make_tetrahedra(HOLES, None)
    grid = UnstructuredGrid("g", cells.points, {"tetra": cells.corners.astype(np.int64)}, {"f": cells.values})
    right = expected(scene_of(((THIN, grid),), "outside"), ((THIN, grid),), (), ())
    section = THIN.model_copy(update={"opacity_unit_distance": 2 * scale})
    grids = ((section, replace(grid, points=scale * grid.points)),)
    camera = CAMERAS["outside"]
    there = {key: tuple(scale * x for x in getattr(camera, key)) for key in ("position", "focal_point")}
    scene = scene_of(grids, "outside").model_copy(update={"camera": camera.model_copy(update=there)})
    assert np.abs(scenes.drawn(None, prepared(scene, grids, (), ()))[0] - right).max() <= 1e-5


def test_tetrahedra_converge_to_the_volume_at_second_order() -> None:
    """Of the same samples of a smooth field: both interpolate it with errors of the square of their distance."""
    cells = np.array([5, 10, 20])
    errors = []
    for count in cells:
        spacing = 6 / count
        grid = lattice(count, count, count, field=slow_waves, spacing=spacing)
        places = spacing * np.stack(np.indices((count + 1,) * 3)[::-1], axis=-1).reshape(-1, 3)
        samples = slow_waves(places).reshape((count + 1,) * 3).astype(np.float32)
        look = {**LOOK, "cmap": THIN.cmap, "opacity": THIN.opacity}
        volume = Volume(**look), samples, Grid(samples.shape, (spacing,) * 3, (0, 0, 0))
        pictures = []
        for grids, volumes in ((((THIN, grid),), ()), ((), (volume,))):
            scene = scene_of(grids, "outside", volumes, step=0.1)
            scene = scene.model_copy(update={"quality": Quality(step=0.1, classification="pre-integrated")})
            pictures.append(scenes.drawn(None, prepared(scene, grids, volumes, ()))[0])
        errors.append(np.sqrt(np.mean((pictures[1] - pictures[0]) ** 2)))
    order = -np.polyfit(np.log(cells), np.log(errors), 1)[0]
    assert 1.8 <= order <= 2.3, errors


def drawn_by(section: GridSection, grid: UnstructuredGrid, camera: str, pieces: int = 1, **keys: Any) -> Any:
    """The picture, and the counts of a k-buffer."""
    ready = prepared(scene_of(((section, grid),), camera, **keys), ((section, grid),), (), ())
    (results,) = scenes.draw_pieces(None, ready, scenes.pieces_of(ready, pieces))
    return scenes.picture_of(ready, results), results[0]


def by_entries(section: GridSection, k: int, entries: Any = "sorted", integration: Any = "exact") -> GridSection:
    return section.model_copy(update={"visibility": KBuffer(k=k, entries=entries, integration=integration)})


BUFFERED = [("lattice", "along edges"), *(("holes", camera) for camera in VIEWS)]
BUFFERED += [(name, "outside") for name in ("peaks", "arrays of cells", "mirrored", "clipped")]


@pytest.mark.cover("clipped-outside")
@pytest.mark.parametrize(("name", "camera"), BUFFERED)
def test_k_buffers_that_suffice_draw_the_exact_picture(name: str, camera: str) -> None:
    ((entry,), _, _, keys, _, _) = CASES[name]
    exact = drawn_by(*entry, camera, **keys)[0]
    assert exact[..., 3].max() > 0.2
    for entries in ("sorted", "unsorted"):
        found, result = drawn_by(by_entries(entry[0], 16, entries), entry[1], camera, **keys)
        assert result.kbuffer.wrong_pixels == 0
        assert np.abs(found - exact).max() <= 2e-5, entries


def test_k_buffers_count_as_the_analysis_does() -> None:
    """A picture of long cells beside short ones, whose centroids are not in the order of fragments."""
    thin = replace(HOLES, points=HOLES.points * [1, 1, 8])
    scene = scene_of(((THIN, thin),), "long")
    cells = make_tetrahedra(thin, None)
    faces = find_neighbours(cells.corners, len(cells.points)).faces().corners
    needs = analyse(cells.points, faces, scene.camera, scene.image.size)
    assert needs.wrong(2) > needs.wrong(3) > 0
    exact = drawn_by(THIN, thin, "long")[0]
    for entries in ("sorted", "unsorted"):
        for k in (2, 3):
            found, result = drawn_by(by_entries(THIN, k, entries), thin, "long")
            np.testing.assert_array_equal(result.fragments.sum(), needs.fragments.sum())
            expected_counts = comparisons(needs.fragments, k, entries == "sorted").sum()
            assert (result.kbuffer.wrong_pixels, result.kbuffer.comparisons) == (needs.wrong(k), expected_counts)
            wrong = np.abs(found - exact).max(axis=2) > 1e-5
            assert 0 < wrong.sum() <= needs.wrong(k)


@pytest.mark.cover("inside")
@pytest.mark.parametrize("camera", ["outside", "inside"])
def test_parts_and_bricks_do_not_change_the_picture_of_a_k_buffer(camera: str) -> None:
    section = by_entries(THIN, 16)
    first = drawn_by(section, HOLES, camera)[0]
    for brick, pieces in ((64, 3), (13, 1)):
        assert np.abs(drawn_by(section, HOLES, camera, pieces, brick=brick)[0] - first).max() <= 1e-5, brick


@pytest.mark.cover
@pytest.mark.parametrize(
    ("section", "grid", "bound"), [(THIN, HOLES, 5e-3), (PEAKS, HOLES, 0.05), (OF_CELLS, CELLS, 1e-2)]
)
def test_a_table_of_integrals_is_right_to_its_resolution(
    section: GridSection, grid: UnstructuredGrid, bound: float
) -> None:
    exact = drawn_by(section, grid, "outside")[0]
    error = np.abs(drawn_by(by_entries(section, 16, integration="table"), grid, "outside")[0] - exact).max()
    assert 1e-6 < error < bound


@pytest.mark.cover("exact")
@pytest.mark.gl
@pytest.mark.parametrize("integration", ["exact", "table"])
def test_opengl_draws_and_counts_k_buffers_as_cpus_do(integration: str, context: moderngl.Context) -> None:
    thin = replace(HOLES, points=HOLES.points * [1, 1, 8])
    section = by_entries(THIN, 3, "sorted" if integration == "table" else "unsorted", integration)
    given = prepared(scene_of(((section, thin),), "long"), ((section, thin),), (), ())
    cpu, opengl = (scenes.draw(where, given) for where in (None, context))
    assert np.abs(cpu.partial.rgba - opengl.partial.rgba).max() <= 3e-6
    assert cpu.kbuffer == opengl.kbuffer
    assert opengl.kbuffer.wrong_pixels > 0
    np.testing.assert_array_equal(cpu.fragments, opengl.fragments)


def placed(entry: Entry, scale: float, offset: float) -> Entry:
    """A grid in another place, in units of another length."""
    section, grid = entry
    points = scale * grid.points + offset
    unit = {"opacity_unit_distance": scale * (section.opacity_unit_distance or 1.0)}
    return section.model_copy(update=unit), replace(grid, points=points)


@pytest.mark.cover
@pytest.mark.parametrize(
    ("name", "camera", "scale", "offset", "bound"),
    [
        ("holes", "outside", 1.0, 0.0, 5e-7),
        ("peaks", "inside", 1.0, 0.0, 5e-7),
        ("clipped", "inside", 1.0, 0.0, 5e-7),
        ("holes", "outside", 1e-9, 0.0, 5e-7),
        ("holes", "outside", 1.0, 1e9, 5e-7),
        ("geometry", "outside", 1.0, 0.0, 4e-6),
        ("two, one lit", "inside", 1.0, 0.0, 4e-6),
        ("volume", "outside", 1.0, 0.0, 4e-6),
    ],
)
def test_bricks_and_parts_change_neither_pictures_nor_counts(
    name: str, camera: str, scale: float, offset: float, bound: float
) -> None:
    given, volumes, meshes, keys, *_ = CASES[name]
    grids = tuple(placed(entry, scale, offset) for entry in given)

    def drawn(brick: int) -> list[tuple[np.ndarray, int]]:
        scene = scene_of(grids, camera, volumes, meshes, **keys, brick=brick)
        at = {key: tuple(scale * x + offset for x in getattr(scene.camera, key)) for key in ("position", "focal_point")}
        scene = scene.model_copy(update={"camera": scene.camera.model_copy(update=at)})
        return scenes.drawn_in(None, prepared(scene, grids, volumes, meshes), (1, 2, 5))

    (first, _), *_ = drawn(600)
    assert first[..., 3].max() > 0.2
    for brick in (3, 7) if volumes else (37, 100):
        pictures, counts = zip(*drawn(brick), strict=True)
        assert max(np.abs(each - first).max() for each in pictures) <= bound, brick
        assert len(set(counts)) == 1


@pytest.mark.parametrize(("name", "camera"), [("holes", "outside"), ("holes", "inside"), ("geometry", "outside")])
def test_segments_count_once(name: str, camera: str) -> None:
    grids, _, meshes, *_ = CASES[name]
    scene = scene_of(grids, camera, (), meshes)
    rays = camera_rays(scene.camera, scene.image.size)
    passages = [find_passages(rays, make_tetrahedra(grid, section.array)) for section, grid in grids]
    found = scenes.drawn(None, prepared(scene, grids, (), meshes), 3)[1]
    assert found == sum(len(each.ray) for each in passages)
