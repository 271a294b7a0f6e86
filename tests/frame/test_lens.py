"""Depth of field: the picture of a thin lens from sub-images and from eye points, and what is refused with it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
import pytest
from data.cells import lattice
from frame.views import draw_all, on_ranks, pixels

from clusterviz.comm import LoopbackChannel
from clusterviz.comm.mpi import MpiChannel
from clusterviz.content.geometry.section import LinesSection, MeshSection, PointsSection
from clusterviz.content.grid.section import GridSection
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points
from clusterviz.data.memory import ArraySource
from clusterviz.errors import SceneError
from clusterviz.frame import render_frame
from clusterviz.reference import over, render_lens
from clusterviz.reference.raycast import disc_points
from clusterviz.scene import Scene, scene_of_data
from clusterviz.scene.lens import lens_points
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Camera, ImageSettings, Volume

CAMERA: dict[str, Any] = {"position": (2.6, 1.9, 1.4), "focal_point": (0.1, 0.0, 0.0), "view_angle": 40.0}
LENS = {"aperture": 1.0, "focal_distance": 2.8}
SCENE = with_settings(
    scene_of_data("field:gaussian:16", ["automatic=false"]),
    {"opacity": [[0.2, 0.0], [0.7, 0.5], [0.9, 1.0]], "clim": (0.0, 1.0), "size": (27, 20), "brick": 4, **CAMERA},
)
WAYS: tuple[tuple[int, dict[str, Any]], ...] = (
    (2, {"transport": "messages", "compositing": "tree"}),
    (3, {"transport": "messages", "compositing": "binary-swap", "codec": "active+lz4"}),
    (5, {"transport": "shared", "distribution": "interleaved"}),
    (3, {"mode": "sort-first"}),
    (5, {"mode": "hybrid", "groups": 2}),
    (3, {"distribution": "dynamic"}),
    (2, {"memory_limit": 20_000}),
)


def behind_lens(scene: Scene = SCENE, **keys: Any) -> Scene:
    return with_settings(scene, LENS | keys)


def drawn(scene: Scene, given: Any = None) -> np.ndarray:
    image = render_frame(scene, LoopbackChannel(), given).image
    assert image is not None
    return image


def quad(depth: float, half: float, colour: Any, centre: tuple[float, float] = (0.0, 0.0)) -> tuple[Any, MeshSection]:
    """A square that faces the eye of `ahead`, at a depth."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half + centre
    points = np.column_stack([corners, np.full(4, -depth)]).astype(np.float32)
    mesh = Mesh("m", points, np.array([[0, 1, 2], [0, 2, 3]]))
    return Geometry(mesh=mesh), MeshSection(path="a", color=colour, ambient=1.0, diffuse=0.0, specular=0.0)


def ahead(*quads: tuple[Any, MeshSection], size: tuple[int, int] = (60, 48), **keys: Any) -> tuple[Scene, list[Any]]:
    camera = Camera(position=(0, 0, 0), focal_point=(0, 0, -10), view_up=(0, 1, 0), view_angle=40.0)
    scene = Scene(meshes=tuple(section for _, section in quads), camera=camera, image=ImageSettings(size=size))
    return with_settings(scene, keys), [given for given, _ in quads]


def mixture() -> tuple[Scene, list[Any]]:
    """Two volumes, a mesh, a line and points, in one another, and the opaque among them."""
    rng = np.random.default_rng(3)
    fog = Volume(path="a", clim=(0, 1), opacity=[[0.3, 0], [1, 0.2]], opacity_unit_distance=2.0)
    tetrahedron = np.array([[1, 1, 1], [9, 3, 2], [3, 9, 2], [4, 4, 9]], np.float32)
    mesh = Mesh("m", tetrahedron, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))
    line = Lines("l", np.array([[0, 9, 5], [9, 0, 5]], np.float32), np.array([0, 2]))
    scene = Scene(
        volumes=(fog, fog.model_copy(update={"origin": (2.0, 1.0, 0.5)})),
        meshes=(MeshSection(path="a", color="red", opacity=0.5),),
        lines=(LinesSection(path="a", radius=0.4, color="lime"),),
        points=(PointsSection(path="a", radius=0.7),),
        camera=Camera(position=(24, 20, 16), focal_point=(5, 5, 4), view_up=(0, 0, 1)),
        image=ImageSettings(size=(27, 22)),
    )
    voxels = [ArraySource(rng.random((10, 11, 12)).astype(np.float32)) for _ in range(2)]
    points = Points("p", (9 * rng.random((7, 3))).astype(np.float32))
    given = [*voxels, Geometry(mesh=mesh), Geometry(lines=line), Geometry(points=points)]
    return with_settings(scene, {"brick": 5, "focal_distance": 25.0}), given


def grid() -> tuple[Scene, list[Any]]:
    scene = Scene(grids=(GridSection(path="g.vtu", opacity=0.5, opacity_unit_distance=0.5),))
    camera = {"position": (4, 5, 3), "focal_point": (0.5, 0.7, 1.0), "focal_distance": 6.0}
    return with_settings(scene, {"size": (25, 20), **camera}), [lattice(2, 3, 4, spacing=0.5)]


ALONE: dict[str, dict[str, Any]] = {
    "composite": {},
    "lit and clipped": {"shade": True, "planes": [[[0.1, 0, 0], [1, 0.2, 0]]], "opacity": 0.4},
    "pre-integrated": {"classification": "pre-integrated"},
    "isosurfaces": {"isosurfaces": [[0.3, 0.4], 0.6], "blending": "isosurface"},
    "surfaces within": {"isosurfaces": [[0.5, 0.4]]},
    "adaptive": {"adaptive": 0.02},
    "ends early": {"early_termination": 1e-6},
    "off axis": {"window_center": (0.3, -0.2)},
}


WITHIN_A_SLAB = {"surfaces within": 1e-3, "mixture": 5e-3}
"""Bounds where the end of a range of depths may change the order of a slab and of what is in it."""


@pytest.mark.cover("mixture")
@pytest.mark.parametrize("content", [*ALONE, "mixture", "grid"])
def test_sub_images_over_each_other_are_the_picture_of_the_pinhole(
    content: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = {"mixture": mixture, "grid": grid}
    scene, given = made[content]() if content in made else (with_settings(SCENE, ALONE[content]), None)
    counted: list[int] = []

    def composited(tall: np.ndarray, lens: Any) -> np.ndarray:
        counted.append(lens.count)
        rows, columns = (slice(lens.margin, lens.margin + side) for side in lens.size[::-1])
        sub_images = tall.reshape(-1, lens.count, tall.shape[1], 4)
        return np.asarray(over(list(np.moveaxis(sub_images, 1, 0).astype(float)))[rows, columns], np.float32)

    monkeypatch.setattr(import_module("clusterviz.render.lens"), "depth_of_field", composited)
    found = drawn(with_settings(scene, {"aperture": {"mixture": 4.0, "grid": 2.0}.get(content, 1.0)}), given)
    assert counted[0] > 4
    np.testing.assert_allclose(found, drawn(scene, given), atol=WITHIN_A_SLAB.get(content, 2e-5))


@pytest.fixture(scope="module")
def alone() -> np.ndarray:
    """Picture of one rank, with one brick; not that of the pinhole."""
    found = drawn(behind_lens(brick=64))
    assert np.abs(found - drawn(SCENE)).max() > 0.05
    return found


@pytest.mark.cover
@pytest.mark.parametrize(("ranks", "keys"), WAYS, ids=str)
def test_any_ranks_and_modes_give_the_same_picture(alone: np.ndarray, ranks: int, keys: dict[str, Any]) -> None:
    (frame,) = on_ranks(ranks, [behind_lens(**keys)], check=True)
    np.testing.assert_allclose(pixels(frame), alone, atol=1e-5)


@pytest.mark.mpi(ranks=[3], timeout=120)
def test_mpi_gives_the_same_pictures(mpi_ranks: int) -> None:
    channel, scenes = MpiChannel(), [behind_lens(), behind_lens(lens={"eye_points": 3})]
    frames = draw_all(scenes, channel, check=True)
    if channel.rank == 0:
        for frame, scene in zip(frames, scenes, strict=True):
            np.testing.assert_allclose(pixels(frame), drawn(scene), atol=1e-5)


def test_a_pinhole_pays_nothing_and_has_the_same_bits() -> None:
    image = drawn(SCENE)
    np.testing.assert_array_equal(drawn(with_settings(SCENE, {"focal_distance": 3.0, "aperture": 0})), image)
    np.testing.assert_array_equal(drawn(behind_lens(lens={"eye_points": 1})), image)
    np.testing.assert_array_equal(drawn(behind_lens(aperture=1e-12)), image)


def test_eye_points_are_those_of_the_reference() -> None:
    scene, source = _complete(behind_lens(lens={"eye_points": 5}))
    expected = render_lens(scene, source.grid, source.read((0, 0, 0), source.grid.shape_zyx), points=lens_points(5))
    np.testing.assert_allclose(drawn(scene), expected, atol=1e-5)


def test_sub_images_are_near_many_eye_points_of_the_reference() -> None:
    """Far nearer than the pinhole; the reference itself has converged to less than what is measured."""
    scene, source = _complete(behind_lens())
    voxels = source.read((0, 0, 0), source.grid.shape_zyx)
    expected, fewer = (render_lens(scene, source.grid, voxels, points=disc_points(n)) for n in (48, 24))
    rms = [float(np.sqrt(np.mean((one - expected) ** 2))) for one in (drawn(scene), fewer, drawn(SCENE))]
    assert rms[1] < 0.6 * rms[0]
    assert rms[0] < 0.25 * rms[2]
    assert rms[0] < 0.012


def _complete(scene: Scene) -> tuple[Scene, Any]:
    from clusterviz.data import open_volume

    return render_frame(scene, LoopbackChannel()).scene, open_volume(scene.volumes[0])


def test_what_is_in_focus_is_sharp_and_its_blurred_foreground_and_background_do_not_bleed() -> None:
    """Three squares: in front, in focus, and behind; where only the middle one is near, its bits are the pinhole's."""
    squares = quad(10.0, 1.8, "red"), quad(30.0, 2.0, "blue", (12.0, 8.0)), quad(4.0, 0.4, "lime", (-1.2, -0.9))
    scene, given = ahead(*squares, focal_distance=10.0)
    sharp, lens = drawn(scene, given), drawn(with_settings(scene, {"aperture": 0.6}), given)
    middle = slice(17, 26), slice(28, 37)
    np.testing.assert_allclose(lens[middle], sharp[middle], atol=1e-4)
    assert sharp[24, 30].tolist() == pytest.approx([1, 0, 0, 1], abs=1e-5)
    blurred = np.abs(lens - sharp).max(axis=-1) > 0.05
    assert blurred[:16, 40:].any()
    assert blurred[32:, :24].any()
    # Premultiplied colours of a single hue stay so: no part of another one is in them.
    far = lens[:16, 44:]
    np.testing.assert_allclose(far[..., 2], far[..., 3], atol=1e-5)


@pytest.mark.parametrize("depth", [4.0, 25.0])
def test_blur_keeps_the_light_of_a_small_square(depth: float) -> None:
    scene, given = ahead(quad(depth, 0.05 * depth, "red"), focal_distance=10.0)
    sharp, lens = drawn(scene, given), drawn(with_settings(scene, {"aperture": 0.8}), given)
    assert lens.max() < 0.97
    np.testing.assert_allclose(lens.sum(axis=(0, 1)), sharp.sum(axis=(0, 1)), rtol=0.02)
    # The variance of a disc of radius r is r² / 4 along each axis, which is added to that of the square.
    pixel = 2 * np.tan(np.radians(20)) / 48
    radius = 0.8 * abs(1 / 10.0 - 1 / depth) / pixel
    columns = np.arange(60)
    spread = [np.average((columns - 29.5) ** 2, weights=one[..., 3].sum(axis=0)) for one in (sharp, lens)]
    assert spread[1] - spread[0] == pytest.approx(radius**2 / 4, rel=0.2)


def test_a_surface_through_many_depths_has_no_seams() -> None:
    """A floor; where the pinhole sees nothing else around, it is as opaque behind the lens."""
    corners = np.array([[-40, -1, -2], [40, -1, -2], [40, -1, -60], [-40, -1, -60]], np.float32)
    mesh = Geometry(mesh=Mesh("m", corners, np.array([[0, 1, 2], [0, 2, 3]])))
    section = MeshSection(path="a", color="white", ambient=1.0, diffuse=0.0, specular=0.0)
    scene, given = ahead((mesh, section), focal_distance=8.0, aperture=0.5)
    lens = drawn(scene, given)
    assert lens[31:40, 4:-4, 3].min() > 0.97
    assert lens[31:40, 4:-4, 3].max() <= 1 + 1e-6


def test_constant_colour_stays_constant() -> None:
    source = ArraySource(np.ones((6, 40, 40), np.float32))
    colours = {"cmap": [[0, 0.2, 0.5, 0.7], [2, 0.2, 0.5, 0.7]], "opacity": 1.0, "clim": (0, 2)}
    place = {"position": (20.0, 21.0, -40.0), "focal_point": (20.0, 21.0, 0.0), "view_up": (0, 1, 0)}
    scene = with_settings(Scene(volumes=(Volume(path="a"),)), {**colours, **place, "size": (31, 24), "aperture": 3.0})
    for distance in (15.0, 42.0, 200.0):
        found = drawn(with_settings(scene, {"focal_distance": distance}), [source])
        np.testing.assert_allclose(found, np.broadcast_to([0.2, 0.5, 0.7, 1.0], found.shape), atol=1e-4)


INSIDE = {"position": (0.1, 0.05, 0.0), "focal_point": (1.0, 0.3, 0.2)}
EXTREMES: list[dict[str, Any]] = [
    *({"size": size} for size in [(1, 1), (1, 9), (9, 1)]),
    *({"focal_distance": distance} for distance in (1e-9, 1e-3, 1e3, 1e12)),
    *({"aperture": aperture} for aperture in (1e-300, 1e3, 1e300)),
    INSIDE,
    INSIDE | {"aperture": 1e3, "focal_distance": 1e-3},
    {"background": "transparent", "lens": {"sub_images": 3}},
    {"opacity": 0.0},
    {"position": (50, 50, 50), "focal_point": (60, 60, 60)},
    {"pixel": "uint8"},
    {"lens": {"eye_points": 2}, "blending": "maximum"},
]


@pytest.mark.cover
@pytest.mark.parametrize("keys", EXTREMES, ids=str)
def test_lenses_at_the_edge_of_sense(keys: dict[str, Any]) -> None:
    scene = behind_lens(**keys)
    (one,), (three,) = on_ranks(1, [scene]), on_ranks(3, [scene])
    found = pixels(one)
    assert found.shape == (*scene.image.size[::-1], 4)
    assert np.isfinite(found).all()
    assert found.min() >= -1e-6
    assert found.max() <= 1 + 1e-5
    np.testing.assert_allclose(pixels(three), found, atol=1e-5 if scene.quality.pixel == "float32" else 0.05)


def test_nothing_has_no_depth_of_field() -> None:
    assert drawn(with_settings(Scene(), {"size": (5, 4), **CAMERA, **LENS})).tolist() == np.zeros((4, 5, 4)).tolist()


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"aperture": -1.0}, "camera.aperture: too small; found -1.0; allowed at least 0"),
    ({"aperture": float("nan")}, "camera.aperture: not finite"),
    ({"aperture": float("inf")}, "camera.aperture: not finite"),
    ({"focal_distance": 0.0}, "camera.focal_distance: too small; found 0.0; allowed more than 0"),
    ({"focal_distance": -2.0}, "camera.focal_distance: too small"),
    ({"focal_distance": float("nan")}, "camera.focal_distance: not finite"),
    ({"parallel_scale": 1.0}, "camera.aperture: not with parallel_scale: a thin lens has perspective; found 1.0"),
    ({"layers": ["depth"]}, "image.layers: not with camera.aperture"),
    ({"blending": "maximum"}, "volumes[0].blending: not with camera.aperture"),
    ({"frame_coherence": True}, "quality.frame_coherence: not with camera.aperture; found true"),
    ({"max_error": 0.01}, "quality.max_error: not with camera.aperture"),
    ({"early_discarding": 0.0}, "quality.early_discarding: not with camera.aperture"),
    ({"lens": {}}, "quality.lens: not one of sub_images and eye_points"),
    ({"lens": {"sub_images": 4, "eye_points": 4}}, "quality.lens: not one of sub_images and eye_points"),
    ({"lens": {"sub_images": 2}}, "quality.lens.sub_images: too small; found 2; allowed at least 3"),
    ({"lens": {"eye_points": 0}}, "quality.lens.eye_points: too small; found 0; allowed at least 1"),
    ({"window_center": [0, float("nan")]}, "camera.window_center[1]: not finite"),
]


@pytest.mark.parametrize(("keys", "said"), REFUSED, ids=[said.partition(":")[0] for _, said in REFUSED])
def test_what_a_lens_cannot_be_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError) as caught:
        behind_lens(**keys)
    assert said in str(caught.value)


def test_frames_may_change_the_lens() -> None:
    changes: tuple[dict[str, Any], ...] = ({"aperture": 0.0}, {}, {"focal_distance": 2.5}, {"position": (2, 2.2, 1.4)})
    scenes = [behind_lens(**change) for change in changes]
    for found, scene in zip(on_ranks(3, scenes), scenes, strict=True):
        np.testing.assert_allclose(pixels(found), drawn(scene), atol=1e-5)
