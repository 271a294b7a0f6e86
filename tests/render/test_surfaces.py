"""Isosurfaces against the reference: every crossing, lit, cut by planes, in any bricks."""

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
    noise,
    picture,
    pictures,
    prepare,
    scene_of,
    whole,
)
from render.test_clip import clip_of
from render.test_independence import in_parts
from render.test_raycast import GRIDS
from render.test_shading import LIGHTS, LIT, smooth

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
BOUND = 1e-4
SIZE = (24, 20)


def surfaces(voxels: np.ndarray, *shares: float, **look: Any) -> dict[str, Any]:
    """The look of half-transparent surfaces at shares of the range; the last one is opaque."""
    low, high = float(np.nanmin(voxels)), float(np.nanmax(voxels))
    values = [low + share * (high - low) for share in shares]
    entries = [*((value, 0.4) for value in values[:-1]), (values[-1], 1.0)]
    return {"blending": "isosurface", "isosurfaces": entries, **look}


# One pixel of the 480: a ray that only just reaches a value is a matter of the last bit.
FEW = 0.0025


def most_wrong(found: list[np.ndarray], expected: np.ndarray, bound: float = BOUND) -> float:
    """Of the pictures of all casters."""
    return max(wrong(one, expected, bound) for one in found)


def wrong(found: np.ndarray, expected: np.ndarray, bound: float = BOUND) -> float:
    """The share of pixels beyond the bound, of pictures that show something."""
    assert expected[..., 3].max() > 0.3
    return float((np.abs(found - expected).max(axis=-1) > bound).mean())


@pytest.mark.parametrize("lit", [False, True], ids=["flat", "lit"])
@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
def test_surfaces_are_those_of_the_reference(context: moderngl.Context, dtype: str, lit: bool) -> None:
    voxels = smooth(dtype=dtype)
    look = surfaces(voxels, 0.55, 0.7, 0.4) | (LIT if lit else {})
    for camera, step in (("outside", 1.0), ("inside", 1.4), ("parallel", 0.6)):
        scene = scene_of(voxels, camera_at(camera, GRID), step=step, look=look, parts={"lights": LIGHTS})
        expected = render_reference(scene, GRID, voxels)
        assert wrong(picture(context, scene, voxels, brick=7), expected) == 0, camera


@pytest.mark.parametrize("camera", CAMERAS)
def test_surfaces_of_noise_from_every_camera(context: moderngl.Context, camera: str) -> None:
    """Every slab holds some, in cells that a ray passes in a corner as well."""
    voxels = noise()
    scene = scene_of(voxels, camera_at(camera, GRID), step=0.6, look=surfaces(voxels, 0.3, 0.5, 0.93, **LIT))
    found = pictures(context, scene, voxels, brick=7)
    assert most_wrong(found, render_reference(scene, GRID, voxels)) <= FEW


@pytest.mark.parametrize("name", GRIDS)
def test_surfaces_on_every_grid(context: moderngl.Context, name: str) -> None:
    voxels, grid = smooth(dtype=np.uint16), GRIDS[name]
    scene = scene_of(voxels, camera_at("outside", grid), look=surfaces(voxels, 0.55, 0.4, **LIT))
    assert wrong(picture(context, scene, voxels, grid, brick=7), render_reference(scene, grid, voxels)) <= FEW


def test_surfaces_between_nearest_voxels(context: moderngl.Context) -> None:
    """They are the faces between voxels, lit by the voxel behind."""
    voxels = smooth()
    look = surfaces(voxels, 0.55, 0.4, **LIT)
    scene = scene_of(voxels, camera_at("outside", GRID), look=look, interpolation="nearest", step=0.93)
    assert most_wrong(pictures(context, scene, voxels, brick=7), render_reference(scene, GRID, voxels)) == 0


@pytest.mark.parametrize("name", ["plane", "both"])
def test_planes_cut_surfaces_where_they_meet(context: moderngl.Context, name: str) -> None:
    voxels = smooth()
    for camera in ("outside", "parallel-along-an-axis"):
        scene = scene_of(
            voxels,
            camera_at(camera, GRID),
            look=surfaces(voxels, 0.55, 0.4, **LIT),
            parts={"clip": clip_of(GRID, name)},
            step=0.93,
        )
        expected = render_reference(scene, GRID, voxels)
        assert most_wrong(pictures(context, scene, voxels, brick=7), expected) <= 0.005, camera


def test_pictures_do_not_depend_on_the_step(context: moderngl.Context) -> None:
    """White noise, which crosses a value up to three times in a cell."""
    voxels = noise()
    look = surfaces(voxels, 0.3, 0.93, **LIT)
    scenes = [scene_of(voxels, camera_at("outside", GRID), step=step, look=look) for step in (100.0, 2.0, 0.1)]
    for found in zip(*(pictures(context, scene, voxels) for scene in scenes), strict=True):
        assert np.array_equal(found[0], found[1])
        assert wrong(found[1], found[2]) <= FEW


def test_shells_thinner_than_slabs_have_no_holes(context: moderngl.Context) -> None:
    """Rays enter and leave them within a slab, whose ends are both outside."""
    z, y, x = np.indices((24, 24, 24)) - 11.5
    voxels = np.exp(-(((np.sqrt(x * x + y * y + z * z) - 7) / 0.7) ** 2)).astype(np.float32)
    grid = Grid(voxels.shape)
    look = {"blending": "isosurface", "isosurfaces": [(0.5, 1.0)], "shade": True}
    scenes = [scene_of(voxels, camera_at("outside", grid), step=step, look=look) for step in (1.0, 0.1)]
    coarse, fine = (render_reference(scene, grid, voxels) for scene in scenes)
    assert wrong(coarse, fine, 1e-9) == 0
    assert most_wrong(pictures(context, scenes[0], voxels, grid), fine) <= FEW


@pytest.mark.parametrize("brick", [5, 16, 33, 64])
def test_bricks_leave_no_seams(context: moderngl.Context, brick: int) -> None:
    voxels = smooth((40, 35, 70), np.uint8)
    grid = Grid(voxels.shape)
    scene = scene_of(voxels, camera_at("outside", grid), step=2.0, look=surfaces(voxels, 0.7, 0.55, **LIT))
    one, other = (draw(context, prepare(scene, voxels, grid, side)) for side in (70, brick))
    assert wrong(whole(other.partial, SIZE), whole(one.partial, SIZE), 1e-5) == 0


def test_parts_drawn_apart_make_the_whole(context: moderngl.Context) -> None:
    voxels = smooth(dtype=np.uint8)
    scene = scene_of(voxels, camera_at("outside", GRID), look=surfaces(voxels, 0.7, 0.55, **LIT))
    prepared = prepare(scene, voxels, brick=7)
    drawn = whole(draw(context, prepared).partial, SIZE)
    for parts in (2, 5):
        assert wrong(in_parts(context, scene, prepared, parts)[0], drawn, 1e-5) == 0


def test_only_bricks_with_a_surface_are_drawn(context: moderngl.Context) -> None:
    voxels = np.broadcast_to(np.arange(64, dtype=np.uint8), (20, 20, 64)).copy()
    grid = Grid(voxels.shape)
    look = {"blending": "isosurface", "isosurfaces": [20.0]}
    scene = scene_of(voxels, camera_at("outside", grid), clim=(0, 64), opacity=1.0, look=look)
    prepared = prepare(scene, voxels, grid, brick=8)
    assert (prepared.plan.cost.any(axis=(0, 1)) == [False, False, True, False, False, False, False, False]).all()
    assert wrong(picture(context, scene, voxels, grid, 8), render_reference(scene, grid, voxels)) == 0


def test_surfaces_without_opacity_are_an_empty_picture(context: moderngl.Context) -> None:
    voxels = smooth()
    look = {"blending": "isosurface", "isosurfaces": [(0.5, 0.0)]}
    assert not picture(context, scene_of(voxels, camera_at("outside", GRID), look=look), voxels).any()


def test_invalid_voxels_hide_surfaces(context: moderngl.Context) -> None:
    voxels = smooth()
    voxels[np.random.default_rng(1).random(SHAPE) < 0.02] = np.nan
    scene = scene_of(voxels, camera_at("outside", GRID), clim=(0.1, 0.9), look=surfaces(voxels, 0.55, 0.4, **LIT))
    found, expected = pictures(context, scene, voxels, brick=7), render_reference(scene, GRID, voxels)
    assert np.isfinite(found).all()
    assert most_wrong(found, expected) <= FEW


def test_many_dispatches_find_every_surface(context: moderngl.Context) -> None:
    voxels = noise((9, 8, 11))
    grid = Grid(voxels.shape)
    scene = scene_of(voxels, camera_at("outside", grid), step=2e-3, size=(6, 5), look=surfaces(voxels, 0.3, 0.9))
    assert wrong(picture(context, scene, voxels, grid), render_reference(scene, grid, voxels)) == 0


@pytest.mark.parametrize("camera", ["outside", "inside", "parallel"])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_surfaces_stand_in_the_volume(context: moderngl.Context, dtype: str, camera: str) -> None:
    voxels = smooth(dtype=dtype)
    look = surfaces(voxels, 0.7, 0.55, **LIT) | {"blending": "composite"}
    keys: dict[str, Any] = {"opacity": ((0.0, 0.0), (0.6, 0.05), (1.0, 0.3)), "step": 0.93, "unit": 3.0}
    for parts in ({}, {"clip": clip_of(GRID, "both")}):
        scene = scene_of(voxels, camera_at(camera, GRID), look=look, parts=parts, **keys)
        expected = render_reference(scene, GRID, voxels)
        assert most_wrong(pictures(context, scene, voxels, brick=7), expected) <= FEW
        alone = scene_of(voxels, camera_at(camera, GRID), look=LIT, parts=parts, **keys)
        assert np.abs(expected - render_reference(alone, GRID, voxels)).max() > 0.1
    prepared = prepare(scene, voxels, brick=7)
    drawn = whole(draw(context, prepared).partial, SIZE)
    assert wrong(in_parts(context, scene, prepared, 5)[0], drawn, 1e-5) <= FEW


def test_transparent_surfaces_leave_the_volume_as_it_is(context: moderngl.Context) -> None:
    """A slab that is cut in two absorbs as a whole one."""
    voxels = smooth()
    plain = picture(context, scene_of(voxels, camera_at("outside", GRID)), voxels)
    look = {"isosurfaces": [(0.5, 1e-9)]}
    assert (
        np.abs(picture(context, scene_of(voxels, camera_at("outside", GRID), look=look), voxels) - plain).max() <= 1e-6
    )
