"""Pre-integrated classification against the reference; and that neither bricks nor what is skipped change it."""

from __future__ import annotations

from dataclasses import replace
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
from render.test_clip import clip_of
from render.test_independence import BOUND as PARTS_BOUND
from render.test_independence import FAINT, in_parts
from render.test_raycast import GRIDS
from render.test_shading import LIGHTS, LIT, smooth

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.scene.values import Scene

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-5
PEAKS = (
    (0.0, 0.0),
    *((p + d, a) for p, a in ((0.35, 0.3), (0.55, 0.6), (0.8, 0.9)) for d, a in ((-0.03, 0.0), (0.0, a), (0.03, 0.0))),
    (1.0, 0.0),
)
JUMPS = ((0.0, 0.0), (0.4, 0.0), (0.4, 0.3), (0.6, 0.3), (0.6, 0.0), (1.0, 0.2))


def scene_between(voxels: np.ndarray, camera: str, grid: Grid = GRID, **keys: Any) -> Scene:
    """A scene whose slabs are classified between their ends."""
    return scene_of(voxels, camera_at(camera, grid), classification="pre-integrated", **keys)


def error(context: moderngl.Context, scene: Scene, voxels: np.ndarray, grid: Grid = GRID) -> float:
    """Error against the reference, by every ray caster that can draw it, of a picture that shows something."""
    expected = render_reference(scene, grid, voxels)
    assert expected[..., 3].max() > 0.05
    return max(float(np.abs(found - expected).max()) for found in pictures(context, scene, voxels, grid, brick=7))


@pytest.mark.parametrize("opacity", [PEAKS, JUMPS, 0.3], ids=["peaks", "jumps", "number"])
@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_pictures_are_those_of_the_reference(context: moderngl.Context, dtype: str, opacity: Any) -> None:
    voxels = noise(dtype=dtype)
    for step in (0.4, 1.0, 2.0):
        assert error(context, scene_between(voxels, "outside", opacity=opacity, step=step), voxels) <= BOUND, step


@pytest.mark.parametrize("camera", CAMERAS)
def test_every_camera(context: moderngl.Context, camera: str) -> None:
    voxels = noise()
    assert error(context, scene_between(voxels, camera), voxels) <= BOUND


@pytest.mark.parametrize("name", GRIDS)
def test_every_grid(context: moderngl.Context, name: str) -> None:
    voxels, grid = noise(dtype=np.uint16), GRIDS[name]
    unit = 8.0 * min(grid.spacing)
    assert error(context, scene_between(voxels, "outside", grid, unit=unit), voxels, grid) <= BOUND


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_light_and_planes(context: moderngl.Context, interpolation: str) -> None:
    voxels = smooth()
    parts = {"lights": LIGHTS, "clip": clip_of(GRID, "both")}
    scene = scene_between(voxels, "outside", look=LIT, parts=parts, interpolation=interpolation)
    assert error(context, scene, voxels) <= BOUND


def test_invalid_voxels_are_left_out_as_in_the_reference(context: moderngl.Context) -> None:
    voxels = noise()
    voxels[np.random.default_rng(1).random(SHAPE) < 0.01] = np.nan
    scene = scene_between(voxels, "outside", clim=(-0.8, 0.8))
    assert error(context, scene, voxels) <= BOUND


def test_a_longer_step_is_cut_to_what_bricks_have_room_for(context: moderngl.Context) -> None:
    voxels = noise(dtype="uint8")
    two, long = (picture(context, scene_between(voxels, "outside", step=step), voxels) for step in (2.0, 30.0))
    assert np.array_equal(two, long)
    assert error(context, scene_between(voxels, "outside", step=30.0), voxels) <= BOUND


@pytest.mark.parametrize("look", [{}, LIT], ids=["flat", "lit"])
@pytest.mark.parametrize("camera", ["outside", "inside", "on-a-face", "parallel-along-an-axis"])
def test_neither_bricks_nor_boxes_change_the_picture(
    context: moderngl.Context, camera: str, look: dict[str, Any]
) -> None:
    voxels = noise(dtype="uint8")
    for step in (0.3, 1.0, 2.0):
        scene = scene_between(voxels, camera, opacity=FAINT, step=step, look=look)
        one = draw(context, prepare(scene, voxels, brick=64))
        assert whole(one.partial, (24, 20))[..., 3].max() > 0.01
        for where in (context,) if look else (context, None):
            for brick, parts in ((5, 3), (11, 2)):
                found, samples = in_parts(where, scene, prepare(scene, voxels, brick=brick), parts)
                assert samples == one.samples
                assert np.abs(found - whole(one.partial, (24, 20))).max() <= (10 if look else 1) * PARTS_BOUND


@pytest.mark.parametrize("step", [1.0, 2.0])
def test_skipping_leaves_out_nothing(context: moderngl.Context, step: float) -> None:
    """Blobs between transparent groups: slabs whose midpoints lie in one reach into the other."""
    voxels = np.zeros((40, 41, 43), np.uint8)
    voxels[7:10, 7:10, 8:24] = voxels[16:17, 24:25, 15:16] = voxels[30:33, 32, 31:34] = 200
    grid = Grid(voxels.shape)
    scene = scene_between(voxels, "outside", grid, clim=(0.0, 200.0), opacity=((0.0, 0.0), (0.02, 0.3)), step=step)
    skipped = prepare(scene, voxels, grid, 16)
    lit_up = replace(skipped, plan=replace(skipped.plan, transfer=_opaque(skipped.plan.transfer)))
    for found, all_of_it in (
        (draw(context, skipped), draw(context, lit_up)),
        (draw_on_cpu(skipped), draw_on_cpu(lit_up)),
    ):
        # Runs of slabs begin elsewhere, so sums are rounded elsewhere.
        assert np.abs(whole(found.partial, (24, 20)) - whole(all_of_it.partial, (24, 20))).max() <= 1e-7
        assert whole(found.partial, (24, 20))[..., 3].max() > 0.1
        assert found.samples < 0.7 * all_of_it.samples


def _opaque(transfer: Any) -> Any:
    """One that hides nothing; the plan's segments still draw as before."""
    return replace(transfer, opacities=np.full_like(transfer.opacities, 0.5))
