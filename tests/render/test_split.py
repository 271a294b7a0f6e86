"""Slabs that are cut where they leave a brick, against the reference; who draws which bricks changes nothing."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, draw, drawn_by_each, noise, picture, pictures, prepare, scene_of, whole
from render.test_clip import clip_of
from render.test_independence import BOUND as PARTS_BOUND
from render.test_independence import FAINT, in_parts
from render.test_shading import LIT, smooth

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.scene.values import Cluster, Scene

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-5
SIZE = (24, 20)


def split_scene(
    voxels: np.ndarray, camera: str, brick: int, parts: Any = None, grid: Grid = GRID, **keys: Any
) -> Scene:
    """A scene whose slabs are cut at the faces of its bricks."""
    parts = {"cluster": Cluster(brick=brick)} | (parts or {})
    how = {"classification": "pre-integrated", "borders": "split"} | keys
    return scene_of(voxels, camera_at(camera, grid), parts=parts, **how)


@pytest.mark.parametrize(
    ("camera", "brick", "keys"),
    [
        ("outside", 7, {}),
        ("inside", 5, {"step": 2.0}),
        ("on-an-edge", 8, {"step": 0.6}),
        ("parallel-along-an-axis", 4, {"step": 1.7}),
        ("parallel", 9, {"look": LIT, "interpolation": "cubic", "size": (9, 7)}),
        ("outside", 6, {"parts": {"clip": clip_of(GRID, "both")}, "jitter": True, "step": 1.5}),
    ],
    ids=["outside", "inside", "on an edge", "along an axis", "lit and cubic", "clipped and jittered"],
)
def test_pictures_are_those_of_the_reference(
    context: moderngl.Context, camera: str, brick: int, keys: dict[str, Any]
) -> None:
    voxels = smooth() if "look" in keys else noise(dtype="uint8")
    scene = split_scene(voxels, camera, brick, **keys)
    expected = render_reference(scene, GRID, voxels)
    overlap = scene.model_copy(update={"quality": scene.quality.model_copy(update={"borders": "overlap"})})
    assert np.abs(expected - render_reference(overlap, GRID, voxels)).max() > 1e-4, "the cuts change nothing"
    if "look" in keys:
        assert np.abs(picture(context, scene, voxels, brick=brick) - expected).max() <= 4 * BOUND
    else:
        for found in pictures(context, scene, voxels, brick=brick):
            assert np.abs(found - expected).max() <= BOUND


def test_invalid_voxels_behind_a_face_are_of_no_account(context: moderngl.Context) -> None:
    """And where rays enter by the volume's far faces, those in front of these are."""
    voxels = noise()
    voxels[np.random.default_rng(3).random(SHAPE) < 0.1] = np.nan
    scene = split_scene(voxels, "outside", 5, clim=(-0.8, 0.8))
    expected = render_reference(scene, GRID, voxels)
    for found in pictures(context, scene, voxels, brick=5):
        assert np.abs(found - expected).max() <= BOUND


@pytest.mark.parametrize("camera", ["outside", "inside", "on-a-face", "parallel-along-an-axis"])
def test_boxes_of_the_same_bricks_make_the_same_picture(context: moderngl.Context, camera: str) -> None:
    voxels = noise(dtype="uint8")
    scene = split_scene(voxels, camera, 5, opacity=FAINT, step=1.3)
    prepared = prepare(scene, voxels, brick=5)
    for where, one in zip((context, None), drawn_by_each(context, prepared), strict=True):
        for parts in (2, 5):
            found, samples = in_parts(where, scene, prepared, parts)
            assert samples == one.samples
            assert np.abs(found - whole(one.partial, SIZE)).max() <= PARTS_BOUND


def test_long_rays_go_on_where_they_stopped(context: moderngl.Context) -> None:
    voxels = noise((9, 8, 11))
    grid = Grid(voxels.shape)
    keys: dict[str, Any] = {"opacity": 0.3, "unit": 3.0, "step": 8e-3, "size": (1, 1)}
    scene = split_scene(voxels, "outside", 3, grid=grid, **keys)
    found = picture(context, scene, voxels, grid, brick=3)
    assert np.abs(found - render_reference(scene, grid, voxels)).max() <= BOUND


def test_skipping_leaves_out_nothing_and_bricks_hold_less(context: moderngl.Context) -> None:
    voxels = np.zeros((40, 41, 43), np.uint8)
    voxels[7:10, 7:10, 8:24] = voxels[16:17, 24:25, 15:16] = voxels[30:33, 32, 31:34] = 200
    grid = Grid(voxels.shape)
    keys: dict[str, Any] = {"clim": (0.0, 200.0), "opacity": ((0.0, 0.0), (0.02, 0.3)), "grid": grid}
    scenes = [split_scene(voxels, "outside", 16, borders=name, **keys) for name in ("split", "overlap")]
    split, overlap = (prepare(scene, voxels, grid, 16) for scene in scenes)
    expected = render_reference(scenes[0], grid, voxels)
    assert expected[..., 3].max() > 0.1
    whole_slabs = draw(context, overlap)
    for drawn in drawn_by_each(context, split):
        assert np.abs(whole(drawn.partial, SIZE) - expected).max() <= BOUND
        assert drawn.samples < 1.2 * whole_slabs.samples
    sizes = [sum(samples.nbytes for samples in prepared.bricks.values()) for prepared in (split, overlap)]
    assert sizes[0] < 0.8 * sizes[1]
