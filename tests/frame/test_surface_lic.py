"""Surface LIC of frames: the same on any ranks, on the surface's own light only, and nothing where there is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel, run_loopback
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.vectors import VectorArray
from clusterviz.errors import DataError
from clusterviz.frame import FrameLoop, Options, render_frame
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Scene
from clusterviz.viewer.shown import visible

CUBE = Grid((33, 33, 33), (1 / 16,) * 3, (-1.0, -1.0, -1.0))
CAMERA = {"position": [2.0, -3.2, 1.6], "focal_point": [0, 0, 0], "view_up": [0, 0, 1], "view_angle": 36}
FLOW = {"path": "field:abc:32", "show": "surface-lic", "color_by": "color", "lic": {"length": 16}}


def ball(radius: float, side: int = 24) -> Mesh:
    """A sphere of triangles."""
    polar, around = np.meshgrid(
        np.linspace(0.02, np.pi - 0.02, side), np.arange(2 * side) * np.pi / side, indexing="ij"
    )
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    row, column = np.indices((side - 1, 2 * side)).reshape(2, -1)
    a, b = row * 2 * side + column, row * 2 * side + (column + 1) % (2 * side)
    faces = np.concatenate([np.stack([a, a + 2 * side, b + 2 * side], 1), np.stack([a, b + 2 * side, b], 1)])
    return Mesh("ball", (radius * points.reshape(-1, 3)).astype(np.float32), faces)


def cloud() -> np.ndarray:
    """Values that fall from the middle of the cube, float32."""
    z, y, x = (np.indices(CUBE.shape_zyx, np.float32) / 16 - 1) * np.reshape([1.0, 1.2, 0.9], (3, 1, 1, 1))
    return np.asarray(1 - np.sqrt(x * x + y * y + z * z) / 2, np.float32)


def scene_of(name: str, **keys: Any) -> tuple[Scene, list[Any]]:
    """A scene, and the content of its files."""
    volume: dict[str, Any] = {"path": "a", "clim": [0, 1], "opacity": 0.0}
    meshes: list[dict[str, Any]] = [{"path": "m", "color": [0, 1, 0], "shade": False}]
    given: list[Any] = [ArraySource(cloud(), CUBE), Geometry(mesh=ball(0.7))]
    if name == "mesh alone":
        volume, given = {}, given[1:]
    elif name == "isosurfaces and a mesh":
        volume |= {"isosurfaces": [[0.72, 1.0], [0.55, 0.3]], "opacity": [[0.5, 0], [1, 0.2]], "shade": True}
    elif name == "behind a cloud":
        volume |= {"opacity": [[0.4, 0], [0.65, 0.25], [1, 0.25]], "cmap": [[0, 1, 0, 0], [1, 1, 0, 0]]}
        volume |= {"opacity_unit_distance": 0.5}
    flow = FLOW | keys.pop("flow", {})
    meshes *= keys.pop("meshes", 1)
    made = Scene(volumes=[volume] * bool(volume), meshes=meshes, camera=CAMERA, flows=[flow], image={"size": [52, 44]})
    return with_settings(made, {"brick": 32} | keys), [*given, None]


def image_of(scene: Scene, given: list[Any], ranks: int = 1, device: Any = "cpu") -> np.ndarray:
    given = given[: len(given) - 1 + len(scene.flows)]
    rendered = run_loopback(ranks, lambda channel: render_frame(scene, channel, given, Options(device)))[0]
    assert rendered.image is not None
    return np.asarray(rendered.image)


def without(scene: Scene) -> Scene:
    return scene.model_copy(update={"flows": ()})


def test_the_picture_is_the_same_on_any_ranks() -> None:
    scene, given = scene_of("isosurfaces and a mesh")
    alone, plain = image_of(scene, given), image_of(without(scene), given)
    pattern = alone - plain
    assert np.count_nonzero(pattern.any(axis=-1)) > 200
    assert pattern.max() <= 0
    assert np.array_equal(alone[..., 3], plain[..., 3])
    for ranks, mode in ((2, "sort-last"), (3, "sort-first"), (5, "sort-last"), (7, "hybrid")):
        assert np.array_equal(image_of(scene_of("isosurfaces and a mesh", mode=mode)[0], given, ranks), alone)


def test_only_the_light_of_the_surface_changes() -> None:
    """A red cloud in front of a green ball keeps its red, and so do half of the ball's pixels beyond the vectors."""
    scene, given = scene_of("behind a cloud")
    painted, plain = (image_of(each, given) for each in (scene, without(scene)))
    assert plain[..., 0].max() > 0.1
    assert np.array_equal(painted[..., 0], plain[..., 0])
    there = painted[..., 1] != plain[..., 1]
    shares = 1 - painted[there, 1] / plain[there, 1]
    assert 0.6 < shares.max() <= 0.7 + 1e-6  # the strength
    assert 0.25 < shares.mean() < 0.45
    scene, given = scene_of("behind a cloud", flow={"opacity": 0.0})
    assert np.array_equal(image_of(scene, given), plain)


def test_colours_are_multiplied_by_those_of_the_speed() -> None:
    keys = {"path": "field:constant", "color_by": "speed", "clim": [0, 2], "cmap": [[0, 0, 0, 0], [2, 0, 1, 1]]}
    scene, given = scene_of("mesh alone", flow=keys | {"opacity": 0.0})
    painted, plain = (image_of(each, given) for each in (scene, without(scene)))
    there = painted[..., 1] != plain[..., 1]
    assert there.sum() > 200
    assert np.allclose(painted[there, 1], 0.5 * plain[there, 1])


@pytest.mark.parametrize(
    "keys",
    [
        {"flow": {"path": "field:constant", "scale": 1e-30}, "size": [1, 1]},
        {"size": [1, 25]},
        {"size": [41, 1]},
        {"camera": {"position": [0.1, 0, 0], "focal_point": [1, 0.2, 0], "view_up": [0, 0, 1]}},
        {"camera": CAMERA | {"focal_point": [4, -6.4, 3.2]}},
    ],
)
def test_small_pictures_a_camera_inside_and_one_that_looks_away(keys: dict[str, Any]) -> None:
    scene, given = scene_of("mesh", **keys)
    found, plain = image_of(scene, given, 2), image_of(without(scene), given, 2)
    assert np.isfinite(found).all()
    assert np.array_equal(found[..., 3], plain[..., 3])
    sees_nothing = not plain.any()
    assert sees_nothing == ("camera" in keys and "view_angle" in keys["camera"])
    assert (found == plain).all() == sees_nothing


def test_frames_of_a_loop_and_layers_beside_the_pattern() -> None:
    scene, given = scene_of("isosurfaces and a mesh", layers=["depth", "object"])
    alone = image_of(scene, given)
    with FrameLoop(scene, LoopbackChannel(), given, Options("cpu")) as loop:
        turned = loop.scene.model_copy(update={"camera": loop.scene.camera.model_copy(update={"position": (3, -3, 1)})})
        frames = [one.image for one in loop.frames([(0, loop.scene), (1, turned), (2, loop.scene)])]
    assert np.array_equal(frames[0], alone)
    assert np.array_equal(frames[2], alone)
    assert not np.array_equal(frames[1], alone)
    plain = render_frame(without(scene), LoopbackChannel(), given[:-1], Options("cpu")).image
    assert all(np.array_equal(frames[0].layers[name], plain.layers[name]) for name in ("depth", "object"))
    only = scene_of("isosurfaces and a mesh", flow={"surfaces": ["meshes[0]"]})[0]
    differs = (image_of(only, given) != image_of(without(only), given)).any(axis=-1)
    assert differs.any()
    assert set(np.unique(frames[0].layers["object"][differs])) == {3}


def test_vectors_that_cannot_be_read() -> None:
    scene, given = scene_of("mesh", flow={"path": "field:no-such"})
    with pytest.raises(DataError, match="no-such"):
        image_of(scene, given, 2)


def test_surfaces_keep_their_patterns_while_others_are_hidden() -> None:
    scene = scene_of("isosurfaces and a mesh", flow={"surfaces": ["volumes[0]", "meshes[1]"]}, meshes=2)[0]
    assert visible(scene, ["meshes.0"]).flows[0].surfaces == ("volumes[0]", "meshes[0]")
    assert visible(scene, ["meshes.1"]).flows[0].surfaces == ("volumes[0]",)
    assert not visible(scene, ["volumes.0", "meshes.0", "meshes.1"]).flows


def test_walls_have_the_colour_of_no_speed() -> None:
    flow = {"path": "field:constant", "scale": 1e-30, "color_by": "speed", "clim": [0, 1], "opacity": 0.5}
    scene, given = scene_of("mesh", flow=flow | {"cmap": [[0, 1, 0.5, 1], [1, 0, 0, 0]]})
    given[-1] = VectorArray(np.zeros((2, 2, 2, 3), np.float32), Grid((2, 2, 2), (2.0, 2.0, 2.0), (-1.0, -1.0, -1.0)))
    painted, plain = image_of(scene, given), image_of(without(scene), given)
    assert np.allclose(painted[..., 1], 0.5 * 0.75 * plain[..., 1])
    assert painted.any()
