"""Cubic B-splines against the reference, lit and unlit, in any bricks."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, drawn_by_each, error, noise, picture, pictures, prepare, scene_of, whole
from render.test_independence import in_parts
from render.test_raycast import GRIDS
from render.test_shading import LIGHTS, LIT, smooth
from render.test_surfaces import FEW, most_wrong, surfaces

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.scene.values import Clip

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-5
SIZE = (24, 20)


def cubic_scene(voxels: np.ndarray, camera: str = "outside", grid: Grid = GRID, **keys: Any) -> Any:
    parts = {"lights": LIGHTS} | keys.pop("parts", {})
    return scene_of(voxels, camera_at(camera, grid), interpolation="cubic", parts=parts, **keys)


@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
@pytest.mark.parametrize("camera", ["outside", "inside", "parallel"])
def test_picture_is_that_of_the_reference(context: moderngl.Context, camera: str, dtype: str) -> None:
    voxels = noise(dtype=dtype)
    low, high = (
        float(voxels.min()) / 2 + float(voxels.max()) / 2 + s * np.ptp(voxels.astype(float)) for s in (-0.2, 0.2)
    )
    scene = cubic_scene(voxels, camera, clim=(low, high), step=0.9)
    expected = render_reference(scene, GRID, voxels)
    linear = scene_of(voxels, camera_at(camera, GRID), clim=(low, high), step=0.9)
    assert np.abs(expected - render_reference(linear, GRID, voxels)).max() > 0.05
    assert error(context, expected, scene, voxels, brick=7) <= BOUND


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_light_follows_the_derivative_of_the_splines(context: moderngl.Context, dtype: str) -> None:
    voxels = smooth(dtype=dtype)
    scene = cubic_scene(voxels, look=LIT)
    expected = render_reference(scene, GRID, voxels)
    assert error(context, expected, scene, voxels, brick=7) <= 4 * BOUND


@pytest.mark.parametrize("name", ["turned-and-anisotropic", "nanometres"])
def test_on_other_grids(context: moderngl.Context, name: str) -> None:
    voxels, grid = smooth(dtype=np.uint16), GRIDS[name]
    scene = cubic_scene(voxels, "outside", grid, look=LIT, unit=8 * min(grid.spacing))
    assert error(context, render_reference(scene, grid, voxels), scene, voxels, grid) <= 4 * BOUND


@pytest.mark.parametrize("lit", [False, True], ids=["flat", "lit"])
def test_invalid_voxels_hide_their_cells_and_no_others(context: moderngl.Context, lit: bool) -> None:
    voxels = smooth()
    voxels[np.random.default_rng(1).random(SHAPE) < 0.02] = np.nan
    scene = cubic_scene(voxels, clim=(0.1, 0.9), look=LIT if lit else None, step=0.7)
    expected = render_reference(scene, GRID, voxels)
    assert expected[..., 3].max() > 0.2
    assert error(context, expected, scene, voxels, brick=7) <= 4 * BOUND


def test_constant_field_stays_constant_and_has_no_normals(context: moderngl.Context) -> None:
    for voxels in (np.full(SHAPE, 77, np.uint8), np.full(SHAPE, 0.123, np.float32)):
        low, high = float(voxels[0, 0, 0]) - 0.3, float(voxels[0, 0, 0]) + 0.6
        parts = {"clip": Clip(cap=False)}  # else the volume's faces have normals
        scene = cubic_scene(voxels, clim=(low, high), opacity=0.3, look=LIT, parts=parts)
        dark = scene_of(voxels, camera_at("outside", GRID), clim=(low, high), opacity=0.3)
        found, expected = picture(context, scene, voxels), picture(context, dark, voxels)
        assert np.abs(found[..., :3] - 0.2 * expected[..., :3]).max() <= 1e-6
        assert np.abs(found[..., 3] - expected[..., 3]).max() <= 1e-6


@pytest.mark.parametrize("brick", [5, 16, 33])
def test_bricks_leave_no_seams(context: moderngl.Context, brick: int) -> None:
    voxels = smooth((40, 35, 70), np.uint8)
    # A narrow band of opacity: groups are skipped whose splines do not reach it, and only these.
    band = ((0.0, 0.0), (0.45, 0.0), (0.5, 0.5), (0.55, 0.0), (1.0, 0.0))
    grid = Grid(voxels.shape)
    scene = cubic_scene(voxels, "outside", grid, look=LIT, opacity=band)
    expected = render_reference(scene, grid, voxels)
    sides = (drawn_by_each(context, prepare(scene, voxels, grid, side)) for side in (70, brick))
    for one, other in zip(*sides, strict=True):
        assert np.abs(whole(other.partial, SIZE) - whole(one.partial, SIZE)).max() <= BOUND
        assert np.abs(whole(one.partial, SIZE) - expected).max() <= 20 * BOUND


def test_parts_drawn_apart_make_the_whole(context: moderngl.Context) -> None:
    voxels = noise(dtype=np.uint8)
    scene = cubic_scene(voxels)
    prepared = prepare(scene, voxels, brick=7)
    for where, drawn in zip((context, None), drawn_by_each(context, prepared), strict=True):
        for parts in (3, 5):
            found, samples = in_parts(where, scene, prepared, parts)
            assert samples == drawn.samples
            assert np.abs(found - whole(drawn.partial, SIZE)).max() <= BOUND


def test_surfaces_of_splines(context: moderngl.Context) -> None:
    voxels = smooth(dtype=np.uint8)
    scene = cubic_scene(voxels, look=surfaces(voxels, 0.55, 0.45, **LIT))
    assert most_wrong(pictures(context, scene, voxels, brick=7), render_reference(scene, GRID, voxels)) <= FEW


def test_projections_of_splines(context: moderngl.Context) -> None:
    from render.test_projections import look_of, projected

    voxels = noise(dtype="uint8")
    for blending in ("maximum", "average"):
        scene = cubic_scene(voxels, look=look_of(blending, voxels))
        found, _ = projected(context, scene, prepare(scene, voxels, brick=7))
        assert np.abs(found - render_reference(scene, GRID, voxels)).max() <= BOUND


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_eight_fetches_weigh_what_64_voxels_do(context: moderngl.Context, dtype: str) -> None:
    """As far as the texture unit's weights go; its results for 8-bit voxels may have 8 bits."""
    voxels = smooth(dtype=dtype)
    if dtype == "float32":
        voxels[np.random.default_rng(1).random(SHAPE) < 0.02] = np.nan
    clim = (0.1, 0.9) if dtype == "float32" else (25.0, 230.0)
    exact, texture = (
        cubic_scene(voxels, look=LIT | {"shade": False}, clim=clim, filter=name) for name in ("exact", "hardware")
    )
    plain = picture(context, exact, voxels, brick=7)
    assert plain[..., 3].max() > 0.3
    for brick in (7, 64):
        assert np.abs(picture(context, texture, voxels, brick=brick) - plain).max() <= 0.02, brick


def test_the_texture_unit_is_lit_by_exact_gradients(context: moderngl.Context) -> None:
    voxels = smooth()
    scene = cubic_scene(voxels, look=LIT, filter="hardware")
    assert np.abs(picture(context, scene, voxels, brick=7) - render_reference(scene, GRID, voxels)).max() <= 0.02
