"""Projections, against the reference, and merged from parts that were drawn apart."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, Prepared, camera_at, draw, draw_on_cpu, noise, prepare, scene_of, whole

from clusterviz.data.source import Grid
from clusterviz.image.merge import merge_partials
from clusterviz.partition import build_tree, front_to_back
from clusterviz.reference import render_reference
from clusterviz.render.render_result import finish_projection
from clusterviz.scene.blend_modes import BLEND_MODES, Blending
from clusterviz.scene.values import Scene

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-5
BLENDINGS = [name for name, mode in BLEND_MODES.items() if not mode.composited]


def look_of(blending: Blending, voxels: np.ndarray) -> dict[str, Any]:
    low, high = float(np.nanmin(voxels)), float(np.nanmax(voxels))
    return {"blending": blending} | ({"threshold": low + 0.7 * (high - low)} if BLEND_MODES[blending].threshold else {})


def projected(
    context: moderngl.Context | None, scene: Scene, prepared: Prepared, parts: int = 1
) -> tuple[np.ndarray, int]:
    """The finished picture of a scene drawn in parts, and the samples taken; without a context by the processor."""
    plan = prepared.plan
    tree = build_tree(plan.cost, parts)
    order = front_to_back(tree, plan.eye_in_bricks(), plan.view.forward)
    boxes = [tree.leaves[rank].trimmed for rank in order if tree.leaves[rank].cost > 0]
    drawn = [draw(context, prepared, box) if context else draw_on_cpu(prepared, box) for box in boxes]
    merged = merge_partials([part.partial for part in drawn], plan.view.size, plan.blend_mode.operator)
    return finish_projection(plan, merged), sum(part.samples for part in drawn)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
@pytest.mark.parametrize("blending", BLENDINGS)
def test_projection_is_that_of_the_reference(context: moderngl.Context, blending: str, dtype: str) -> None:
    voxels = noise(dtype=dtype)
    for camera in ("outside", "inside", "parallel"):
        scene = scene_of(voxels, camera_at(camera, GRID), step=0.6, unit=30.0, look=look_of(blending, voxels))
        expected = render_reference(scene, GRID, voxels)
        assert 0.1 < expected[..., :3].max() < 1, "the scene shows nothing that could be wrong"
        prepared = prepare(scene, voxels, brick=7)
        for where in (context, None):
            found, _ = projected(where, scene, prepared)
            assert np.abs(found - expected).max() <= BOUND, camera


@pytest.mark.parametrize("blending", BLENDINGS)
def test_parts_drawn_apart_make_the_whole(context: moderngl.Context, blending: str) -> None:
    voxels = noise(dtype="uint8")
    for camera in ("outside", "inside"):
        scene = scene_of(voxels, camera_at(camera, GRID), unit=30.0, look=look_of(blending, voxels))
        prepared = prepare(scene, voxels, brick=7)
        wholes = {where: projected(where, scene, prepared) for where in (context, None)}
        for parts, where in product((2, 5, 7), (context, None)):
            (picture, samples), (found, taken) = wholes[where], projected(where, scene, prepared, parts)
            assert np.abs(found - picture).max() <= 1e-6, f"{camera}, {parts} parts"
            # A part does not know that the ray has ended in front of it.
            assert taken == samples or BLEND_MODES[blending].threshold


@pytest.mark.parametrize("blending", BLENDINGS)
def test_little_memory_changes_nothing(context: moderngl.Context, blending: str) -> None:
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at("outside", GRID), look=look_of(blending, voxels))
    prepared = prepare(scene, voxels, brick=7)
    plenty = whole(draw(context, prepared).partial, scene.image.size)
    little = whole(draw(context, prepared, block_bytes=2000).partial, scene.image.size)
    assert np.abs(little - plenty).max() <= 1e-6 * np.abs(plenty).max()


@pytest.mark.parametrize("blending", BLENDINGS)
def test_invalid_voxels_are_no_samples(context: moderngl.Context, blending: str) -> None:
    voxels = noise()
    voxels[np.random.default_rng(1).random(SHAPE) < 0.03] = np.nan
    look = look_of(blending, voxels)
    scene = scene_of(voxels, camera_at("outside", GRID), clim=(-0.8, 0.8), unit=30.0, step=0.4, look=look)
    for where in (context, None):
        found, _ = projected(where, scene, prepare(scene, voxels, brick=7))
        assert np.abs(found - render_reference(scene, GRID, voxels)).max() <= BOUND


@pytest.mark.parametrize("blending", BLENDINGS)
def test_skipping_changes_no_pixel(context: moderngl.Context, blending: str) -> None:
    """A band of opacity in the middle: above it and below it all is transparent, and half of the volume is constant."""
    voxels = noise((20, 41, 40))
    voxels[:, 20:], voxels[:, :, 30:] = -0.9, 0.9
    band = ((0.0, 0.0), (0.3, 0.0), (0.4, 0.5), (0.6, 0.5), (0.7, 0.0), (1.0, 0.0))
    grid, look = Grid(voxels.shape), look_of(blending, voxels)
    scene = scene_of(voxels, camera_at("outside", grid), clim=(-1, 1), opacity=band, unit=30.0, look=look)
    prepared = prepare(scene, voxels, grid, brick=16)
    found, samples = projected(context, scene, prepared)
    assert np.abs(found - render_reference(scene, grid, voxels)).max() <= BOUND
    faint = tuple((value, max(opacity, 1e-9)) for value, opacity in band)
    everything = prepare(scene_of(voxels, camera_at("outside", grid), clim=(-1, 1), opacity=faint, look=look), voxels)
    _, all_samples = projected(context, scene, everything)
    assert samples < all_samples if blending in ("maximum", "minimum") else samples <= all_samples


def test_many_dispatches_keep_what_was_gathered(context: moderngl.Context) -> None:
    voxels = noise((9, 8, 11))
    grid = Grid(voxels.shape)
    for blending in BLENDINGS:
        look = look_of(blending, voxels)
        scene = scene_of(voxels, camera_at("outside", grid), step=1e-3, unit=30.0, size=(4, 3), look=look)
        found, _ = projected(context, scene, prepare(scene, voxels, grid))
        assert np.abs(found - render_reference(scene, grid, voxels)).max() <= BOUND, blending


@pytest.mark.parametrize(("blending", "beyond"), [("local-maximum", 220.0), ("first-hit", 0.0)])
def test_threshold_is_in_data_values(context: moderngl.Context, blending: Blending, beyond: float) -> None:
    voxels = np.zeros(SHAPE, np.uint8)
    voxels[:, :, 5], voxels[:, :, 13], voxels[:, :, 21] = 90, 150, 220
    camera = camera_at("parallel-along-an-axis", GRID)
    for threshold, scalar in ((80.0, 90.0), (100.0, 150.0), (200.0, 220.0), (230.0, beyond)):
        look = {"blending": blending, "threshold": threshold}
        # Midpoints lie on the odd planes of samples.
        scene = scene_of(voxels, camera, clim=(0, 255), opacity=((0, 0.0), (1, 1.0)), step=2 / 3, look=look)
        found, _ = projected(context, scene, prepare(scene, voxels))
        assert found[10, 12, 3] == pytest.approx(scalar / 255, abs=1e-5)


def test_sum_does_not_depend_on_the_step_where_the_field_is_constant(context: moderngl.Context) -> None:
    voxels = np.full(SHAPE, 0.5, np.float32)
    camera = camera_at("parallel-along-an-axis", GRID)
    for blending, grey in (("average", 0.4 * 0.5), ("additive", 0.4 * 0.5 * 25 / 40)):
        for step in (0.3, 1.0, 7.0):
            look = {"blending": blending}
            scene = scene_of(voxels, camera, clim=(0, 1), opacity=0.4, unit=40.0, step=step, look=look)
            found, _ = projected(context, scene, prepare(scene, voxels))
            assert found[10, 12] == pytest.approx([grey, grey, grey, 1.0], abs=1e-6), (blending, step)


def test_composited_pixels_are_finished_already(context: moderngl.Context) -> None:
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at("outside", GRID))
    prepared = prepare(scene, voxels)
    found, _ = projected(context, scene, prepared, 3)
    assert np.abs(found - render_reference(scene, GRID, voxels)).max() <= BOUND
    assert finish_projection(replace(prepared.plan), found) is found
