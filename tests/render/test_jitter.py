"""Slabs that begin elsewhere in every pixel, against the reference; all boxes and bricks must see the same ones."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, draw, drawn_by_each, noise, prepare, scene_of, whole
from render.test_clip import clip_of
from render.test_independence import BOUND as PARTS_BOUND
from render.test_independence import FAINT, in_parts
from render.test_shading import LIT, smooth

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.reference.rays import pixel_shifts
from clusterviz.render.render_result import finish_projection
from clusterviz.scene.values import Quality

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-5
CASES: dict[str, dict[str, Any]] = {
    "step 4": {"step": 4.0},
    "one slab": {"step": 100.0},
    "clipped": {"parts": {"clip": clip_of(GRID, "both")}, "step": 1.7},
    "pre-integrated": {"classification": "pre-integrated", "step": 2.0},
    "average": {"look": {"blending": "average"}, "step": 3.0},
    "local maximum": {"look": {"blending": "local-maximum", "threshold": 190.0}, "step": 3.0},
    "lit": {"look": LIT, "step": 2.0},
}


@pytest.mark.parametrize("name", CASES)
def test_pictures_are_those_of_the_reference(context: moderngl.Context, name: str) -> None:
    voxels = smooth() if name == "lit" else noise(dtype="uint8")
    for camera in ("outside", "inside") if name in ("clipped", "pre-integrated") else ("parallel",):
        scene = scene_of(voxels, camera_at(camera, GRID), jitter=True, **CASES[name])
        expected = render_reference(scene, GRID, voxels)
        straight = scene.model_copy(update={"quality": scene.quality.model_copy(update={"jitter": False})})
        changes = np.abs(expected - render_reference(straight, GRID, voxels)).max()
        assert changes > 0.01, "the jitter changes nothing"
        prepared = prepare(scene, voxels, brick=7)
        for drawn in drawn_by_each(context, prepared):
            found = finish_projection(prepared.plan, whole(drawn.partial, (24, 20)))
            assert np.abs(found - expected).max() <= BOUND * (4 if name == "lit" else 1)


@pytest.mark.parametrize("classification", ["post", "pre-integrated"])
def test_neither_bricks_nor_boxes_change_the_picture(context: moderngl.Context, classification: str) -> None:
    voxels = noise(dtype="uint8")
    keys: dict[str, Any] = {"opacity": FAINT, "classification": classification, "jitter": True, "step": 1.3}
    for camera in ("inside", "parallel-along-an-axis"):
        scene = scene_of(voxels, camera_at(camera, GRID), **keys)
        one = draw(context, prepare(scene, voxels, brick=64))
        for where in (context, None):
            found, samples = in_parts(where, scene, prepare(scene, voxels, brick=5), 3)
            assert samples == one.samples
            assert np.abs(found - whole(one.partial, (24, 20))).max() <= PARTS_BOUND


def test_shifts_are_spread_evenly() -> None:
    shifts = pixel_shifts((256, 128))
    assert 0 <= shifts.min() < 1e-3
    assert 0.999 < shifts.max() < 1
    assert abs(shifts.mean() - 0.5) < 5e-3
    assert abs(shifts.std() - 12**-0.5) < 5e-3
    rows = shifts.reshape(128, 256) - 0.5
    for beside in (rows[1:] * rows[:-1], rows[:, 1:] * rows[:, :-1]):
        assert abs(beside.mean()) < 2e-3, "neighbours are alike"


def test_jitter_is_a_switch() -> None:
    assert Quality().jitter is False
