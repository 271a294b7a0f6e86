"""Automatic settings: classes of volumes, and the settings of each."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel
from clusterviz.content.automatic import BACKGROUND, STEP, classify_values
from clusterviz.content.complete import complete_scene
from clusterviz.content.transfer import transfer_function
from clusterviz.content.volume.kind import visible_corners
from clusterviz.content.volume.presets import PRESETS, PresetName, apply_preset
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.errors import SceneError
from clusterviz.frame import Options, Run
from clusterviz.frame.opening import open_content
from clusterviz.scene import Scene, VolumeInfo, load_scene, scene_of_data
from clusterviz.scene.camera import project_points

SIDE = 24
Z, Y, X = (axis / (SIDE - 1) * 2 - 1 for axis in np.mgrid[:SIDE, :SIDE, :SIDE].astype(float))
R = np.sqrt(X * X + Y * Y + Z * Z)
NOISE = np.random.default_rng(0).normal(0, 1, R.shape)
BODY = np.select([R < 0.3, R < 0.8], [700.0, 40.0], -1000.0) + 20 * NOISE
VOLUMES: dict[str, tuple[np.ndarray, str]] = {
    "a mask": (R < 0.6, "mask"),
    "a mask of 255": (np.where(R < 0.6, 255, 0).astype(np.uint8), "mask"),
    "labels": (np.select([R < 0.3, R < 0.6, X < 0], [7.0, 3.0, 90.0], 0.0).astype(np.float32), "labels"),
    "labels next to each other": (np.select([R < 0.3, R < 0.6], [2, 1], 0), "labels"),
    "computed tomography": (BODY.astype(np.int16), "tissue"),
    "a smooth byte field": ((20 * (1 - R / 2)).astype(np.uint8), "foreground"),
    "a noisy byte field": (np.abs(3 * NOISE).astype(np.uint8), "foreground"),
    "seismic": ((300 * np.sin(9 * Z + X)).astype(np.float32), "signed"),
    "a noisy tomogram": ((300 * NOISE).astype(np.float32), "block"),
    "a thin simulation": (np.hypot(X, Y)[:3].astype(np.float32), "block"),
    "magnetic resonance": ((np.where(R < 0.7, 120, 5) + 4 * NOISE).astype(np.int16), "foreground"),
    "one value": (np.full(R.shape, 3.0), "foreground"),
    "nothing": (np.full(R.shape, np.nan), "foreground"),
}


def facts_of(voxels: np.ndarray, brick: int = 64, modality: str = "") -> VolumeInfo:
    scene = scene_of_data("array", [f"cluster.brick={brick}"])
    z, y, x = voxels.shape
    source = ArraySource(voxels, Grid((z, y, x), modality=modality))
    _, opened, _ = open_content(Run(LoopbackChannel(), Options()), scene, source)
    assert opened is not None
    return opened.infos[0]


@functools.cache
def info_of(name: str) -> VolumeInfo:
    return facts_of(VOLUMES[name][0])


def completed(voxels: np.ndarray, *options: str) -> Scene:
    return complete_scene(scene_of_data("array", options), facts_of(voxels))


@pytest.mark.cover
@pytest.mark.parametrize("name", VOLUMES)
def test_the_kind_of_a_volume_and_that_it_can_be_shown(name: str) -> None:
    voxels, kind = VOLUMES[name]
    assert [classify_values(facts_of(voxels, brick)) for brick in (64, 5)] == [kind, kind]
    scene = completed(voxels)
    again = Scene.model_validate(scene.model_dump(mode="json"))
    assert (again, again.automatic, again.quality.step) == (scene, False, STEP)
    assert complete_scene(again, facts_of(voxels)) == scene


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a mask", {"blending": "isosurface", "isosurfaces": ((0.5, 1.0),), "interpolation": "cubic"}),
        ("labels", {"interpolation": "nearest", "clim": (0, 90), "shade": True}),
        ("computed tomography", {"clim": (-400, 1500), "shade": True}),
        ("seismic", {"cmap": "coolwarm"}),
        ("magnetic resonance", {"cmap": "bone", "interpolation": "linear"}),
    ],
)
def test_what_is_chosen(name: str, expected: dict[str, Any]) -> None:
    scene = completed(VOLUMES[name][0])
    found = scene.volumes[0].model_dump()
    assert {key: found[key] for key in expected} == expected
    assert scene.image.background == BACKGROUND


def test_what_a_user_says_is_kept_and_an_opacity_ends_the_choosing() -> None:
    voxels = VOLUMES["computed tomography"][0]
    kept = completed(voxels, "cmap=hot", "shade=false", "quality.step=2", "image.background=white")
    volume = kept.volumes[0]
    assert (volume.cmap, volume.shade, kept.quality.step, kept.image.background) == ("hot", False, 2, "white")
    plain = completed(voxels, "opacity=linear")
    by_hand = Scene.model_validate({"volumes": [{"path": plain.volumes[0].path, "opacity": "linear"}]})
    assert plain.volumes == complete_scene(by_hand, facts_of(voxels)).volumes
    assert (plain.quality, plain.image) == (by_hand.quality, by_hand.image)


PARTICLE = np.where(R < 0.3, 1.0 - R, 0.0) + 0.01 * NOISE


@pytest.mark.parametrize(
    ("voxels", "modality", "expected"),
    [
        (PARTICLE, "density", "density"),
        (PARTICLE, "", "foreground"),
        (np.maximum(PARTICLE, 0), "microscopy", "mip"),
        (NOISE + 9, "density", "block"),
        (NOISE + 9, "", "foreground"),
        (np.floor(30 * R), "labels", "labels"),
        (np.floor(30 * R), "", "foreground"),
        (np.where(R < 0.8, 40.0, -700.0) + 300 * (R < 0.3), "CT", "tissue"),
        (np.where(R < 0.8, 40.0, -700.0) + 300 * (R < 0.3), "MR", "signed"),
    ],
)
def test_what_the_file_says_of_the_values_counts(voxels: np.ndarray, modality: str, expected: str) -> None:
    assert classify_values(facts_of(voxels, modality=modality)) == expected


def test_contour_levels_of_particles_and_crystals() -> None:
    """Of a particle in a box of solvent the level is higher than of a crystal's cell that is full of molecules."""
    for voxels, deviations in ((PARTICLE, 4), (np.sin(9 * X) * np.sin(9 * Y) * np.sin(7 * Z), 2)):
        keys = apply_preset("density", facts_of(voxels))
        assert keys["isosurfaces"][0][0] == pytest.approx(voxels.mean() + deviations * voxels.std(), abs=0.02)


def test_projections_are_chosen_where_the_scene_allows_them() -> None:
    """A stack alone is projected before black; with another volume, or with layers, it is composited."""
    info = facts_of(np.maximum(PARTICLE, 0), modality="microscopy")
    alone = complete_scene(scene_of_data("a.tif"), info)
    assert (alone.volumes[0].blending, alone.image.background) == ("maximum", (0, 0, 0))
    several = complete_scene(scene_of_data("a.tif", keys=({}, {})), (info, info))
    layered = complete_scene(scene_of_data("a.tif", ["image.layers=[depth]"]), info)
    for scene in (several, layered):
        assert {volume.blending for volume in scene.volumes} == {"composite"}
        assert scene.image.background == BACKGROUND


@pytest.mark.parametrize("axis", range(3))
def test_thin_data_are_shown_face_on(axis: int) -> None:
    shape = [3 if axis == each else 40 for each in (2, 1, 0)]
    camera = complete_scene(scene_of_data("array"), facts_of(np.random.default_rng(0).random(shape))).camera
    assert camera.position is not None
    assert camera.focal_point is not None
    towards = np.subtract(camera.position, camera.focal_point)
    assert abs(towards[axis]) == pytest.approx(np.linalg.norm(towards))


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_suits_any_data(name: PresetName) -> None:
    """The keys it sets are those of `apply_preset`; they are valid, and something is visible wherever values differ."""
    for about in VOLUMES:
        info = info_of(about)
        scene = complete_scene(scene_of_data("array", preset=name), info)
        assert Scene.model_validate(scene.model_dump(mode="json")) == scene
        volume = scene.volumes[0]
        assert volume.preset is None
        keys = apply_preset(name, info)
        again = complete_scene(scene.model_copy(update={"volumes": (volume.model_copy(update=keys),)}), info)
        assert again.volumes == scene.volumes, about
        if name in ("bone", "vessels", "tissue", "foreground", "mip", "percentiles") and about == "magnetic resonance":
            shown = transfer_function(volume).opacity(np.linspace(info.minimum, info.maximum, 100))
            assert 0.0 == shown.min() < 0.5 < shown.max()


def test_presets_of_computed_tomography_go_by_hounsfield_units() -> None:
    values = np.array([-1000.0, 40.0, 700.0])  # air, muscle, bone
    opacity = {}
    for name in ("tissue", "bone", "vessels"):
        volume = complete_scene(scene_of_data("array", preset=name), info_of("computed tomography")).volumes[0]
        opacity[name] = transfer_function(volume).opacity(values).tolist()
    assert 0 == opacity["tissue"][0] < opacity["tissue"][1] < 0.1 < 0.5 < opacity["tissue"][2]
    assert opacity["bone"][:2] == opacity["vessels"][:2] == [0, 0]
    assert min(opacity["bone"][2], opacity["vessels"][2]) > 0.5


def test_a_preset_is_part_of_the_scene(tmp_path: Path) -> None:
    """Keys of the scene are kept, but `--preset` replaces them; an unknown name and an excluded key are errors."""
    assert get_args(PresetName) == tuple(PRESETS)
    info, path = info_of("computed tomography"), tmp_path / "scene.yaml"
    path.write_text("volumes: [{path: a.npy, preset: bone, cmap: hot, gradient_opacity: [[0, 0], [9, 1]]}]\n")
    own = complete_scene(load_scene(path), info)
    assert (own.volumes[0].cmap, own.volumes[0].shade, own.image.background) == ("hot", True, "white")
    chosen = complete_scene(load_scene(path, ["ambient=0.5"], "mip"), info).volumes[0]
    assert (chosen.cmap, chosen.blending, chosen.gradient_opacity, chosen.ambient) == ("gray", "maximum", (), 0.5)
    with pytest.raises(
        SceneError, match=r"--preset bon: volumes\[0\].preset: not one of .* allowed tissue, bone, vessels"
    ):
        load_scene(path, preset="bon")
    with pytest.raises(SceneError, match="not for blending: maximum"):
        complete_scene(load_scene(path, ["preset=mip"]), info)
    with pytest.raises(SceneError, match="--preset mip: no volume"):
        scene_of_data("a.stl", sections=("meshes",), preset="mip")


def test_what_is_seen_fills_the_picture() -> None:
    """A small ball in a large volume, wherever bricks begin."""
    voxels = np.where(np.hypot(R - R, np.hypot(X - 0.5, np.hypot(Y, Z))) < 0.3, 200.0, 0.0) + NOISE
    scenes = [complete_scene(scene_of_data("array"), facts_of(voxels, brick)) for brick in (64, 7)]
    assert scenes[0].camera == scenes[1].camera
    corners = visible_corners(scenes[0].volumes[0], facts_of(voxels))
    np.testing.assert_allclose((corners.max(0) + corners.min(0)) / 2, (17.25, 11.5, 11.5), atol=1)
    pixels, _ = project_points(scenes[0].camera, corners, scenes[0].image.size)
    assert np.ptp(pixels[:, 1]) > 0.85 * scenes[0].image.size[1]
