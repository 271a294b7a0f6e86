"""Clipped volumes against the reference: slabs are kept by their midpoints, by all boxes alike."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import (
    CAMERAS,
    SHAPE,
    camera_at,
    draw,
    draw_on_cpu,
    noise,
    picture,
    pictures,
    prepare,
    scene_of,
    whole,
)
from render.test_independence import in_parts
from render.test_raycast import GRIDS

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-5
FAINT = ((0.0, 0.001), (1.0, 0.02))


def clip_of(grid: Grid, name: str) -> dict[str, Any]:
    """Planes and boxes through the middle of a grid, at no special place."""
    corners = grid.corners
    middle, size = corners.mean(axis=0) + 0.01 * (corners[7] - corners[0]), np.ptp(corners, axis=0)
    box = np.stack([middle - 0.31 * size, middle + 0.27 * size], axis=1).ravel().tolist()
    oblique = [middle.tolist(), [0.3, -0.5, 0.8]]
    return {
        "box": {"box": box},
        "plane": {"planes": [oblique]},
        "wedge": {"planes": [oblique, [(middle + 0.1 * size).tolist(), [-2e9, -1e9, 3e8]]]},
        "both": {"planes": [oblique], "box": box},
        "nothing-left": {"planes": [[middle.tolist(), [1, 0, 0]], [(middle - 0.1 * size).tolist(), [-1, 0, 0]]]},
        "nothing-cut": {"planes": [[(corners.min(axis=0) - size).tolist(), [1, 1, 1]]]},
    }[name]


CLIPS = ("box", "plane", "wedge", "both")


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("name", CLIPS)
def test_clipped_picture_is_that_of_the_reference(context: moderngl.Context, name: str, camera: str) -> None:
    voxels = noise(dtype="uint8")
    parts = {"clip": clip_of(GRID, name)}
    for step in (1.03, 0.31, 40.0):
        scene = scene_of(voxels, camera_at(camera, GRID), step=step, parts=parts)
        expected = render_reference(scene, GRID, voxels)
        for found in pictures(context, scene, voxels, brick=7):
            assert np.abs(found - expected).max() <= BOUND, f"step {step}"
        whole_volume = render_reference(scene_of(voxels, camera_at(camera, GRID), step=step), GRID, voxels)
        if step < 2:  # longer slabs are few, and kept or left out as wholes
            assert np.abs(expected - whole_volume).max() > 0.05, f"step {step}"


@pytest.mark.parametrize("grid", GRIDS)
def test_planes_lie_in_the_world(context: moderngl.Context, grid: str) -> None:
    voxels, parts = noise(dtype="uint8"), {"clip": clip_of(GRIDS[grid], "both")}
    scene = scene_of(
        voxels, camera_at("outside", GRIDS[grid]), unit=8 * min(GRIDS[grid].spacing), step=0.93, parts=parts
    )
    expected = render_reference(scene, GRIDS[grid], voxels)
    assert expected[..., 3].max() > 0.1
    for found in pictures(context, scene, voxels, GRIDS[grid]):
        assert np.abs(found - expected).max() <= BOUND


def test_all_or_nothing_may_be_cut_away(context: moderngl.Context) -> None:
    voxels = noise(dtype="uint8")
    camera = camera_at("outside", GRID)
    nothing = scene_of(voxels, camera, parts={"clip": clip_of(GRID, "nothing-left")})
    assert not any(found.any() for found in pictures(context, nothing, voxels))
    everything = scene_of(voxels, camera, parts={"clip": clip_of(GRID, "nothing-cut")})
    uncut = pictures(context, scene_of(voxels, camera), voxels)
    for found, same in zip(pictures(context, everything, voxels), uncut, strict=True):
        assert np.array_equal(found, same)


@pytest.mark.parametrize("name", CLIPS)
def test_parts_drawn_apart_keep_the_same_slabs(context: moderngl.Context, name: str) -> None:
    voxels = noise(dtype="uint8")
    for camera in ("outside", "inside", "parallel-along-an-axis"):
        scene = scene_of(voxels, camera_at(camera, GRID), opacity=FAINT, step=0.3, parts={"clip": clip_of(GRID, name)})
        prepared = prepare(scene, voxels, brick=7)
        for where, drawn in ((context, draw(context, prepared)), (None, draw_on_cpu(prepared))):
            for parts in (2, 5):
                found, samples = in_parts(where, scene, prepared, parts)
                assert samples == drawn.samples
                assert np.abs(found - whole(drawn.partial, scene.image.size)).max() <= 1e-6


def test_plane_on_midpoints_keeps_them(context: moderngl.Context) -> None:
    """Rays along x, midpoints at k + 1/2: a plane through one of them keeps it, whichever way it faces."""
    voxels = np.full(SHAPE, 7, np.uint8)
    camera = camera_at("parallel-along-an-axis", GRID)
    for normal, slabs in ((1, 25 - 12), (-1, 13)):
        parts = {"clip": {"planes": [[[12.5, 0, 0], [normal, 0, 0]]]}}
        scene = scene_of(voxels, camera, clim=(6.5, 7.5), opacity=0.3, unit=8.0, parts=parts)
        for found in pictures(context, scene, voxels):
            assert found[10, 12, 3] == pytest.approx(1 - 0.7 ** (slabs / 8), abs=1e-6)


def test_bricks_that_are_cut_away_are_not_loaded(context: moderngl.Context) -> None:
    voxels = noise((20, 20, 64), np.uint8)
    grid = Grid(voxels.shape)
    scene = scene_of(voxels, camera_at("outside", grid), parts={"clip": {"planes": [[[41, 0, 0], [1, 0, 0]]]}})
    prepared = prepare(scene, voxels, grid, brick=8)
    assert (prepared.plan.cost[..., :5] == 0).all()
    assert (prepared.plan.cost[..., 5:] > 0).all()
    assert np.abs(picture(context, scene, voxels, grid, 8) - render_reference(scene, grid, voxels)).max() <= BOUND


@pytest.mark.parametrize("blending", ["maximum", "average", "local-maximum"])
def test_projections_are_clipped_too(context: moderngl.Context, blending: str) -> None:
    from render.test_projections import look_of, projected

    voxels = noise(dtype="uint8")
    parts = {"clip": clip_of(GRID, "both")}
    scene = scene_of(
        voxels, camera_at("outside", GRID), step=0.93, unit=30.0, look=look_of(blending, voxels), parts=parts
    )
    prepared = prepare(scene, voxels, brick=7)
    expected = render_reference(scene, GRID, voxels)
    for count in (1, 5):
        assert np.abs(projected(context, scene, prepared, count)[0] - expected).max() <= BOUND
