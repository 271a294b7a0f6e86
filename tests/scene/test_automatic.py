"""Automatic settings: classes of volumes, and the settings of each."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.comm import LoopbackChannel
from clusterviz.data.memory import ArraySource
from clusterviz.frame import Options, Run
from clusterviz.frame.opening import open_volumes
from clusterviz.scene import Scene, VolumeInfo, complete_scene, scene_of_data
from clusterviz.scene.automatic import BACKGROUND, STEP, classify_values
from clusterviz.scene.camera import project_points
from clusterviz.scene.complete import visible_corners

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
    "computed tomography": (BODY.astype(np.int16), "hounsfield"),
    "a smooth byte field": ((20 * (1 - R / 2)).astype(np.uint8), "scalar"),
    "a noisy byte field": (np.abs(3 * NOISE).astype(np.uint8), "scalar"),
    "seismic": ((300 * NOISE).astype(np.float32), "signed"),
    "magnetic resonance": ((np.where(R < 0.7, 120, 5) + 4 * NOISE).astype(np.int16), "scalar"),
    "one value": (np.full(R.shape, 3.0), "scalar"),
    "nothing": (np.full(R.shape, np.nan), "scalar"),
}


def facts_of(voxels: np.ndarray, brick: int = 64) -> VolumeInfo:
    scene = scene_of_data("array", [f"cluster.brick={brick}"])
    _, opened, _ = open_volumes(Run(LoopbackChannel(), Options()), scene, ArraySource(voxels))
    assert opened is not None
    return opened.infos[0]


def completed(voxels: np.ndarray, *options: str) -> Scene:
    return complete_scene(scene_of_data("array", options), facts_of(voxels))


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


def test_what_is_seen_fills_the_picture() -> None:
    """A small ball in a large volume, wherever bricks begin."""
    voxels = np.where(np.hypot(R - R, np.hypot(X - 0.5, np.hypot(Y, Z))) < 0.3, 200.0, 0.0) + NOISE
    scenes = [complete_scene(scene_of_data("array"), facts_of(voxels, brick)) for brick in (64, 7)]
    assert scenes[0].camera == scenes[1].camera
    corners = visible_corners(scenes[0].volumes[0], facts_of(voxels))
    np.testing.assert_allclose((corners.max(0) + corners.min(0)) / 2, (17.25, 11.5, 11.5), atol=1)
    pixels, _ = project_points(scenes[0].camera, corners, scenes[0].image.size)
    assert np.ptp(pixels[:, 1]) > 0.85 * scenes[0].image.size[1]
