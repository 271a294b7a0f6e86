"""2-D transfer functions against the reference: gradient opacity, and tables over scalars and magnitudes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import (
    BUMP,
    SHAPE,
    camera_at,
    draw,
    drawn_by_each,
    error,
    picture,
    pictures,
    prepare,
    rotation,
    scene_of,
    whole,
)
from render.test_independence import in_parts
from render.test_shading import LIGHTS, LIT, smooth

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.scene.values import Scene

pytestmark = pytest.mark.gl

GRID = Grid(SHAPE)
TURNED = Grid(SHAPE, spacing=(2e-9, 1e-9, 1.5e-9), origin=(1e-7, 0, 0), direction=rotation((1, 2, 3), 40.0))
HUGE = Grid(SHAPE, spacing=(1e9, 2e9, 1e9))
BOUND = 1e-5
SIZE = (24, 20)
RISE = ((0.02, 0.0), (0.1, 0.3), (0.1, 0.6), (0.3, 1.0))
"""Magnitudes in units of the range of values per smallest spacing; with a step."""
STEEPEST = 0.35


def graded_scene(voxels: np.ndarray, grid: Grid = GRID, points: Any = RISE, **keys: Any) -> Scene:
    """A scene with gradient opacity."""
    per = float(np.ptp(voxels.astype(float))) / min(grid.spacing)
    look = {"gradient_opacity": [(m * per, factor) for m, factor in points]} | keys.pop("look", {})
    keys = {"unit": 8 * min(grid.spacing), "camera": camera_at("outside", grid)} | keys
    return scene_of(voxels, look=look, **keys)


def table_scene(voxels: np.ndarray, path: Path, table: np.ndarray, grid: Grid = GRID, **keys: Any) -> Scene:
    """A scene with a table; its ranges are completed here."""
    np.save(path, table)
    low, high = float(voxels.min()), float(voxels.max())
    per = (high - low) / min(grid.spacing)
    settings = {"path": str(path), "values": (low, high), "magnitudes": (0.01 * per, STEEPEST * per)}
    scene = scene_of(voxels, camera_at("outside", grid), opacity=None, unit=8 * min(grid.spacing), **keys)
    volume = scene.volumes[0].model_dump() | {"transfer_2d": settings}
    return Scene.model_validate(scene.model_dump() | {"volumes": [volume]})


def entries(colours: bool = False) -> np.ndarray:
    """A table that is transparent for the lowest scalars, and uneven elsewhere."""
    table = np.random.default_rng(4).random((5, 9, 4))
    table[:, :3, 3] = 0.0
    table[..., 3] *= np.linspace(0.2, 0.8, 5)[:, None]
    return table if colours else table[..., 3]


def off_by(context: moderngl.Context, scene: Scene, voxels: np.ndarray, grid: Grid = GRID) -> float:
    """Largest difference from the reference, of a picture to which the gradient matters."""
    expected = render_reference(scene, grid, voxels)
    plain = {"gradient_opacity": (), "transfer_2d": None, "opacity": scene.volumes[0].opacity or 0.3}
    without = scene.model_copy(update={"volumes": (scene.volumes[0].model_copy(update=plain),)})
    assert expected[..., 3].max() > 0.1
    assert np.abs(expected - render_reference(without, grid, voxels)).max() > 0.03, "the gradient changes nothing"
    return error(context, expected, scene, voxels, grid, brick=7)


@pytest.mark.parametrize(
    ("dtype", "keys"),
    [
        ("uint8", {}),
        ("int16", {"step": 0.4}),
        ("float32", {"interpolation": "cubic"}),
        ("float32", {"interpolation": "nearest", "step": 0.7}),
        ("uint8", {"look": LIT, "parts": {"lights": LIGHTS}}),
        ("uint8", {"look": {"isosurfaces": (120.0,)}}),
        ("uint8", {"classification": "pre-integrated", "look": LIT}),
    ],
    ids=["u8", "i16", "cubic", "nearest", "lit", "with a surface", "pre-integrated"],
)
def test_gradient_opacity_is_that_of_the_reference(context: moderngl.Context, dtype: str, keys: dict[str, Any]) -> None:
    voxels = smooth(dtype=dtype)
    # A surface is found to float32's last bits; what lies in front of it in its slab is absorbed by its length.
    bound = 4 * BOUND if "look" in keys else BOUND
    # No step: to float32, samples beside it fall on either side.
    assert off_by(context, graded_scene(voxels, points=(RISE[0], RISE[-1]), **keys), voxels) <= bound


def test_a_step_of_gradient_opacity_is_a_step(context: moderngl.Context) -> None:
    voxels = smooth()
    expected = render_reference(scene := graded_scene(voxels), GRID, voxels)
    for found in pictures(context, scene, voxels):
        difference = np.abs(found - expected).max(axis=2)
        assert np.count_nonzero(difference > BOUND) <= 2, "more than samples that lie on the step itself"


@pytest.mark.parametrize("grid", [TURNED, HUGE], ids=["turned, 1e-9", "1e9"])
def test_magnitudes_are_those_of_the_world(context: moderngl.Context, grid: Grid, tmp_path: Path) -> None:
    voxels = smooth()
    assert off_by(context, graded_scene(voxels, grid, points=(RISE[0], RISE[-1])), voxels, grid) <= BOUND
    assert off_by(context, table_scene(voxels, tmp_path / "t.npy", entries(), grid), voxels, grid) <= BOUND


@pytest.mark.parametrize("scale", [1e-25, 1e25])
def test_units_of_data_do_not_matter(context: moderngl.Context, scale: float) -> None:
    voxels = smooth((9, 8, 11), np.float64)
    near, far = (np.stack(pictures(context, graded_scene(v, points=RISE[:2]), v)) for v in (voxels, voxels * scale))
    assert np.abs(near - far).max() <= BOUND


@pytest.mark.parametrize("colours", [False, True], ids=["opacity", "colour"])
def test_tables_are_those_of_the_reference(context: moderngl.Context, colours: bool, tmp_path: Path) -> None:
    voxels, path = smooth(dtype=np.uint8), tmp_path / "table.npy"
    keys: dict[str, Any] = {"look": LIT, "step": 0.5} if colours else {"classification": "pre-integrated"}
    assert off_by(context, table_scene(voxels, path, entries(colours), **keys), voxels) <= 4 * BOUND


@pytest.mark.parametrize("shape", [(1, 9), (5, 1), (1, 1)], ids=str)
def test_smallest_tables(context: moderngl.Context, shape: tuple[int, int], tmp_path: Path) -> None:
    voxels = smooth(dtype=np.uint8)
    scene = table_scene(voxels, tmp_path / "table.npy", entries()[: shape[0], 9 - shape[1] :])
    assert error(context, render_reference(scene, GRID, voxels), scene, voxels) <= BOUND


@pytest.mark.parametrize("factor", [0.0, 1.0])
def test_one_point_is_a_factor(context: moderngl.Context, factor: float) -> None:
    voxels = smooth(dtype=np.uint8)
    plain = picture(context, scene_of(voxels, camera_at("outside", GRID), opacity=BUMP), voxels)
    assert error(context, factor * plain, graded_scene(voxels, points=((0.1, factor),)), voxels) <= 2e-6


def test_invalid_voxels_are_left_out_as_in_the_reference(context: moderngl.Context) -> None:
    voxels = smooth()
    scene = graded_scene(voxels, points=(RISE[0], RISE[-1]), clim=(0.1, 0.9))
    voxels[np.random.default_rng(1).random(SHAPE) < 0.03] = np.nan
    expected = render_reference(scene, GRID, voxels)
    assert error(context, expected, scene, voxels, brick=7) <= BOUND


@pytest.mark.parametrize("kind", ["gradient opacity", "table"])
def test_neither_bricks_nor_boxes_change_the_picture(context: moderngl.Context, kind: str, tmp_path: Path) -> None:
    voxels = smooth(dtype=np.uint8)
    has_table = kind == "table"
    scene = table_scene(voxels, tmp_path / "t.npy", entries()) if has_table else graded_scene(voxels)
    for where, one in zip((context, None), drawn_by_each(context, prepare(scene, voxels, brick=64)), strict=True):
        found, samples = in_parts(where, scene, prepare(scene, voxels, brick=5), parts=3)
        # What is transparent is left out by groups of cells, and these begin with each brick.
        assert samples == one.samples or has_table
        assert np.abs(found - whole(one.partial, SIZE)).max() <= BOUND


def test_skipping_leaves_out_nothing(context: moderngl.Context, tmp_path: Path) -> None:
    voxels = np.zeros((40, 41, 43), np.uint8)
    voxels[7:10, 7:10, 8:24] = voxels[16:17, 24:25, 15:16] = voxels[30:33, 32, 31:34] = 200
    grid = Grid(voxels.shape)
    scene = table_scene(voxels, tmp_path / "t.npy", entries(), grid)
    skipped = prepare(scene, voxels, grid)
    opaque = replace(skipped.plan.transfer, opacities=np.full_like(skipped.plan.transfer.opacities, 0.5))
    found, everything = (
        draw(context, skipped),
        draw(context, replace(skipped, plan=replace(skipped.plan, transfer=opaque))),
    )
    assert np.abs(whole(found.partial, SIZE) - whole(everything.partial, SIZE)).max() <= 1e-6
    assert whole(found.partial, SIZE)[..., 3].max() > 0.05
    assert found.samples < 0.7 * everything.samples
