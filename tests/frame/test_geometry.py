"""Meshes, lines and points in the frame loop: they are where they are on any ranks, and what is wrong is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frame.views import FACES, OCTAHEDRON, check_same, moving, on_ranks, pixels, so_far

from clusterviz.comm import LoopbackChannel
from clusterviz.content.geometry.bricks import part_of
from clusterviz.content.geometry.section import GeometrySection, LinesSection, MeshSection, PointsSection, as_sections
from clusterviz.content.visibility import visibility_warnings
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import ClustervizError
from clusterviz.frame import render_frame
from clusterviz.frame.opening import open_content
from clusterviz.frame.run import Options, Run
from clusterviz.image import compare
from clusterviz.plan.plan import changed_settings
from clusterviz.reference import render_reference
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Camera, ImageSettings, Scene, Volume

RNG = np.random.default_rng(5)
GRID = Grid((14, 15, 16))
VOXELS = RNG.random(GRID.shape_zyx).astype(np.float32)
CAMERA = Camera(position=(44, 37, 40), focal_point=(8, 7, 7), view_up=(0, 0, 1))
SECTIONS = {Mesh: ("mesh", MeshSection), Lines: ("lines", LinesSection), Points: ("points", PointsSection)}


def shell(radius: float, centre: Any = (7.2, 6.9, 6.4), **arrays: Any) -> Mesh:
    return Mesh("m", (radius * OCTAHEDRON + centre).astype(np.float32), FACES, **arrays)


def scene_of(*parts: tuple[Any, dict[str, Any]], volumes: int = 1, **keys: Any) -> tuple[Scene, list[Any]]:
    """A scene, and what is given for its volumes and geometry: parts, each with keys of its section."""
    sections: list[GeometrySection] = [SECTIONS[type(part)][1](**{"path": "a", **more}) for part, more in parts]
    given = [ArraySource(VOXELS, GRID)] * volumes
    fog = Volume(path="a", clim=(0, 1), opacity=[[0.3, 0], [1, 0.2]], opacity_unit_distance=2.0)
    scene = Scene(volumes=[fog] * volumes, camera=CAMERA, image=ImageSettings(size=(36, 30)), **as_sections(sections))
    scene = with_settings(scene, keys) if keys else scene
    order = [name for name, _ in SECTIONS.values()]
    geometries = sorted(
        ({SECTIONS[type(part)][0]: part} for part, _ in parts), key=lambda each: order.index(next(iter(each)))
    )
    return scene, [*given, *(Geometry(**each) for each in geometries)]


def infos_of(scene: Scene, given: list[Any]) -> tuple[Scene, Any]:
    completed, opened, _ = open_content(Run(LoopbackChannel(), Options()), scene, given)
    assert opened is not None
    return completed, opened


THREE = (
    (shell(6.0), {"color": "red", "opacity": 0.4}),
    (shell(3.5, vertex_attributes={"heat": np.arange(6.0)}), {"scalars": "heat", "opacity": [[0, 0.2], [5, 0.9]]}),
    (shell(9.0), {"color": "blue", "opacity": 0.3, "shading": "flat", "culling": "front"}),
)
WAYS: list[tuple[int, dict[str, Any]]] = [
    (1, {"brick": 64}),
    (1, {"brick": 5}),
    (3, {"brick": 6}),
    (2, {"brick": 5, "distribution": "interleaved"}),
    (2, {"brick": 7, "distribution": "replicated"}),
    (3, {"brick": 6, "mode": "sort-first"}),
    (5, {"brick": 7, "mode": "hybrid", "groups": 2}),
    (7, {"brick": 40}),  # more ranks than bricks
]


@pytest.mark.cover("0", "2")
@pytest.mark.gl
@pytest.mark.parametrize("volumes", [0, 1, 2])
def test_the_picture_is_the_reference_however_bricks_are_dealt_out(volumes: int) -> None:
    scene, given = scene_of(*THREE, volumes=volumes)
    completed = infos_of(scene, given)[0]
    geometry: list[Any] = list(zip(completed.geometry, [part for part, _ in THREE], strict=True))
    expected = render_reference(completed, [GRID] * volumes, [VOXELS] * volumes, geometry=geometry)
    assert expected[..., 3].max() > 0.5
    for ranks, cluster in WAYS:
        (found,) = on_ranks(ranks, [with_settings(scene, cluster)], given)
        assert compare(pixels(found), expected, 2e-5).count == 0, (ranks, cluster)


@pytest.mark.gl
def test_primitives_migrate_with_the_voxels_of_their_bricks() -> None:
    scene, given = scene_of(*THREE)
    around = [(44, 37, 40), (-30, 20, 10), (8, 60, 7), (44, 37, -40), (20, -50, 30), (-40, -37, 4)]
    scenes = [with_settings(scene, {"position": place, "brick": 5}) for place in around]
    frames = on_ranks(3, moving(scenes), given)
    check_same(frames, [on_ranks(1, [scene], given)[0] for scene in scenes])
    assert so_far(frames, "bricks_received") > 0


@pytest.mark.gl
def test_keys_that_need_no_other_primitives_may_change_between_frames() -> None:
    scene, given = scene_of(*THREE, brick=6)
    keys: list[dict[str, Any]] = [
        {"meshes.1.clim": (1.0, 2.0)},
        {"meshes.1.cmap": "bone", "meshes.1.opacity": 0.5},
        {"meshes.2.culling": "back", "meshes.0.color": "lime", "meshes.0.ambient": 0.5},
        {"meshes.0.edges": {"color": "white", "width": 0.8}},
    ]
    scenes = [scene, *(with_settings(scene, each) for each in keys)]
    check_same(on_ranks(2, moving(scenes), given), [on_ranks(1, [scene], given)[0] for scene in scenes])
    path = Lines("l", np.array([[0, 0, 0], [3, 4, 0.0]]), np.array([0, 2]))
    scene, given = scene_of((path, {"radius": 1.0}), THREE[1])
    refused = ("lines.0.radius", 2.0, "radius: was 1.*"), ("meshes.0.scalars", None, "scalars: was .heat., is null")
    for key, value, said in (*refused, ("meshes.0.shading", "flat", "shading: was .smooth., is .flat.")):
        changed = with_settings(scene, {"meshes.0.opacity": 0.5, key: value})
        with pytest.raises(ClustervizError, match=f"frames differ in more than they can.*{said}"):
            on_ranks(1, [scene, changed], given)


@pytest.mark.gl
def test_a_mesh_apart_from_all_volumes_and_wholly_on_one_rank_is_drawn() -> None:
    scene, given = scene_of((shell(3.0, (40, 7, 7)), {"color": "red", "shade": False}))
    with pytest.warns(UserWarning, match="lies apart from all other content"):
        one, three = (on_ranks(ranks, [with_settings(scene, {"brick": 16})], given)[0] for ranks in (1, 3))
    assert compare(pixels(one), pixels(three), 1e-6).count == 0


NAN_VERTEX = shell(4.0).vertices.copy()
NAN_VERTEX[2] = np.nan
NOTHING = np.empty((0, 3), np.float32)
TRIANGLES_LEFT = "triangles are left out: a vertex is not finite, or they have no area"
FLOW = np.array([[1, 0, 0], [0, 0, 0], [0, np.nan, 1], [1, 2, 3], [0, 0, -1.0]])
CLOUD = Points("p", RNG.random((5, 3)) * 9, {"size": np.array([1.0, 0.0, -1.0, np.nan, 2.0]), "flow": FLOW})


@pytest.mark.parametrize(
    ("part", "keys", "said"),
    [
        (Mesh("m", NOTHING, np.empty((0, 3), int)), {}, "meshes[0] (a): nothing is drawn"),
        (Mesh("m", NAN_VERTEX, FACES), {}, f"meshes[0] (a): 4 of 8 {TRIANGLES_LEFT}"),
        (Mesh("m", shell(4.0).vertices, FACES[:, [0, 1, 1]]), {}, f"meshes[0] (a): 8 of 8 {TRIANGLES_LEFT}"),
        (shell(4.0, (7, 7, 4000)), {}, "check the units (mm or m) and transform"),
        (shell(4.0), {"transform": np.diag([1e-3, 1e-3, 1e-3, 1]) - np.eye(4, k=3)}, "check the units"),
        (Lines("l", np.ones((4, 3)), np.array([0, 4])), {"radius": 1.0}, "3 of 3 segments are left out"),
        (CLOUD, {"radius": "size"}, "points[0] (a): 3 of 5 points are left out"),
        (CLOUD, {"style": "arrows", "direction": "flow"}, "points[0] (a): 2 of 5 points are left out"),
        (shell(4.0), {}, ""),
    ],
)
def test_what_cannot_be_drawn_is_counted(part: Any, keys: dict[str, Any], said: str) -> None:
    scene, opened = infos_of(*scene_of((part, keys)))
    found = list(visibility_warnings(scene, opened.infos, is_blank=False).values())
    assert any(said in text for text in found) if said else found == []
    plan = opened.plan(scene)
    held = dict(opened.read(plan, {tuple(index) for index in np.argwhere(plan.cost > 0).tolist()}))
    numbers = {n for brick in held.values() if brick.members[0] for n in brick.members[0].numbers.tolist()}
    drawn = np.flatnonzero(part.drawable) if isinstance(part, Mesh) else np.arange(plan.content.geometry[0].count)
    assert numbers == set(drawn.tolist())
    assert len(numbers) == plan.content.geometry[0].count


@pytest.mark.parametrize(
    ("part", "keys", "said"),
    [
        (shell(4.0), {"scalars": "heat"}, "meshes[0].scalars: no such array; found heat; allowed none"),
        (THREE[1][0], {"scalars": "cold"}, "meshes[0].scalars: no such array; found cold; allowed heat"),
        (
            shell(4.0, vertex_attributes={"uv": np.ones((6, 2))}),
            {"scalars": "uv"},
            "neither scalars nor colours; found 2 components; allowed 1, 3 or 4",
        ),
        (CLOUD, {"radius": "heat"}, "points[0].radius: no such array of radii; found heat; allowed size, a number"),
        (
            CLOUD,
            {"style": "arrows", "direction": "size"},
            "no such array of vectors; found size, 1 components; allowed flow",
        ),
        (
            CLOUD,
            {"style": "arrows", "direction": "flow", "length": "u"},
            "points[0].length: no such array of numbers; found u",
        ),
    ],
)
def test_missing_arrays_are_errors(part: Any, keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ClustervizError) as caught:
        infos_of(*scene_of((part, keys)))
    assert said in str(caught.value)


def test_a_file_that_is_wrong_is_an_error_with_its_name() -> None:
    with pytest.raises(ClustervizError, match="no such file"):
        render_frame(Scene(meshes=[{"path": "nowhere.ply"}]), LoopbackChannel())  # type: ignore[list-item]


def test_scenes_in_several_units_have_larger_bricks() -> None:
    """A volume of 16 units, and a mesh 4000 times as far away."""
    scene, opened = infos_of(*scene_of((shell(4.0, (7, 7, 64000)), {}), brick=4))
    plan = opened.plan(scene)
    assert plan.cost.size <= 1 << 16
    assert np.count_nonzero(plan.cost) >= 2
    assert plan.layout.brick > 4


def test_open_keys_are_completed_by_the_content() -> None:
    path = Lines("l", np.array([[0, 0, 0], [3, 4, 0.0]]), np.array([0, 2]))
    parts = (THREE[1][0], {"scalars": "heat", "edges": {}}), (path, {}), (Points("p", NOTHING + 1), {}), (CLOUD, {})
    parts = *parts, (Points("p", CLOUD.positions, {"RGB": CLOUD.positions / 9}), {"radius": 1.0})
    scene, opened = infos_of(*scene_of(*parts, volumes=0))
    assert scene.meshes[0].clim == (0, 5)
    assert scene.lines[0].radius == pytest.approx(5 / 500)
    assert scene.meshes[0].edges.width == pytest.approx(7 * 3**0.5 / 1000)
    assert scene.lines[0].color_by == "color"
    assert [each.scalars for each in scene.points] == [None, None, "RGB"]
    assert all(isinstance(each.radius, float) for each in scene.points)
    plan = opened.plan(scene)
    assert [layer.count for layer in plan.content.geometry] == [8, 1, 0, 5, 5]


def test_points_are_the_vertices_of_a_file_without_points() -> None:
    mesh, path = shell(4.0, vertex_attributes={"heat": np.arange(6.0)}), Lines("l", FLOW, np.array([0, 5]))
    for geometry, positions in ((Geometry(mesh, path), mesh.vertices), (Geometry(lines=path), FLOW)):
        found = part_of(PointsSection(path="a"), geometry)
        assert isinstance(found, Points)
        assert found.positions is positions
        assert list(found.attributes) == (["heat"] if geometry.mesh else [])


def test_frame_coherence_is_off_with_surfaces_and_that_is_said() -> None:
    scene, opened = infos_of(*scene_of(THREE[0], frame_coherence=True))
    assert opened.plan(scene).march.frame_coherence is None
    assert [change.key for change in changed_settings(scene, 1)] == ["quality.frame_coherence"]
