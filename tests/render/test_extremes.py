"""Volumes, steps and opacities at their ends. The bound is 1e-5 of full scale, as in test_raycast.py."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, draw, draw_on_cpu, noise, picture, pictures, prepare, scene_of, whole

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.scene.values import Camera, Scene

pytestmark = pytest.mark.gl

BOUND = 1e-5
HARDWARE_BOUND = 0.03
GRID = Grid(SHAPE)


def error(context: moderngl.Context, scene: Scene, voxels: np.ndarray, brick: int = 16) -> float:
    """Largest difference from the reference, of every caster's pictures."""
    grid = Grid(voxels.shape)
    expected = render_reference(scene, grid, voxels)
    return max(float(np.abs(found - expected).max()) for found in pictures(context, scene, voxels, grid, brick))


@pytest.mark.parametrize("shape", [(1, 9, 9), (9, 1, 9), (9, 9, 1), (1, 1, 9), (1, 1, 1)])
@pytest.mark.parametrize("filter", ["exact", "hardware"])
def test_volume_without_thickness_is_an_empty_picture(
    context: moderngl.Context, shape: tuple[int, int, int], filter: str
) -> None:
    for camera in (
        Camera(position=(30, 20, 25), focal_point=(4, 4, 4), view_up=(0, 0, 1)),
        Camera(position=(0, 0, 0), focal_point=(1, 0.2, 0.1), view_up=(0, 0, 1)),
    ):
        scene = scene_of(np.ones(shape, np.uint8), camera, clim=(0.0, 1.0), opacity=1.0, filter=filter)
        assert not any(found.any() for found in pictures(context, scene, np.ones(shape, np.uint8)))


@pytest.mark.parametrize("shape", [(2, 2, 2), (2, 9, 9), (9, 2, 2)])
def test_one_cell_is_enough(context: moderngl.Context, shape: tuple[int, int, int]) -> None:
    voxels = noise(shape, np.uint8)
    scene = scene_of(voxels, camera_at("outside", Grid(shape)), unit=1.0, step=0.2)
    assert picture(context, scene, voxels)[..., 3].max() > 0.1
    assert error(context, scene, voxels) <= BOUND


@pytest.mark.parametrize(("filter", "bound"), [("exact", BOUND), ("hardware", HARDWARE_BOUND)])
@pytest.mark.parametrize("shape", [(2, 3, 5000), (2, 5000, 3), (3000, 2, 2)], ids=["x", "y", "z"])
def test_volume_longer_than_a_texture_may_be(
    context: moderngl.Context, shape: tuple[int, int, int], filter: str, bound: float
) -> None:
    """Drawn in bricks of any size; the far end is looked at, where a position has the most digits."""
    voxels = noise(shape, np.uint8)
    z, y, x = shape
    focal = np.array([x - 1, y - 1, z - 1]) * 0.97
    camera = Camera(
        position=tuple((focal + np.array([3, 6, 5])).tolist()), focal_point=tuple(focal.tolist()), view_up=(0.1, 0, 1)
    )
    for brick in (64, 1024):
        scene = scene_of(voxels, camera, unit=1.0, filter=filter)
        assert picture(context, scene, voxels, brick=brick)[..., 3].max() > 0.1
        # Positions in a brick are float32: their error grows with the brick.
        assert error(context, scene, voxels, brick=brick) <= bound * max(1, brick / 64)


def test_more_bricks_than_fit_beside_each_other_in_a_texture(context: moderngl.Context) -> None:
    """3025 bricks of 3 samples a side; a texture has room for 682 beside each other where its side is 2048."""
    voxels = noise((3, 110, 110), np.uint8)
    scene = scene_of(voxels, camera_at("outside", Grid(voxels.shape)), filter="hardware", size=(16, 12))
    assert error(context, scene, voxels, brick=2) <= HARDWARE_BOUND


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
@pytest.mark.parametrize("filter", ["exact", "hardware"])
def test_constant_field_has_the_opacity_of_its_thickness(context: moderngl.Context, dtype: Any, filter: str) -> None:
    voxels = np.full(SHAPE, 7, dtype)
    scene = scene_of(
        voxels, camera_at("parallel-along-an-axis", GRID), clim=(6.5, 7.5), opacity=0.3, unit=8.0, filter=filter
    )
    alpha = picture(context, scene, voxels)[..., 3]
    assert alpha.max() == pytest.approx(1 - 0.7 ** (25 / 8), abs=1e-6)
    assert error(context, scene, voxels) <= BOUND


@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
def test_invalid_voxels_hide_the_cells_that_they_touch_and_no_others(
    context: moderngl.Context, interpolation: str
) -> None:
    voxels = noise()
    rng = np.random.default_rng(1)
    for value in (np.nan, np.inf, -np.inf):
        voxels[tuple(rng.integers(0, n, 40) for n in SHAPE)] = value
    camera = camera_at("outside", GRID)
    scene = scene_of(voxels, camera, clim=(-0.8, 0.8), opacity=0.2, interpolation=interpolation, step=0.37)
    assert error(context, scene, voxels, brick=7) <= BOUND
    # The voxels next to an invalid one keep their opacity: hidden is what the cells hide, not the whole picture.
    assert picture(context, scene, voxels)[..., 3].max() > 0.2


def test_volume_of_invalid_voxels_is_an_empty_picture(context: moderngl.Context) -> None:
    voxels = np.full(SHAPE, np.nan, np.float32)
    scene = scene_of(voxels, camera_at("outside", GRID), clim=(0.0, 1.0), opacity=1.0)
    assert not any(found.any() for found in pictures(context, scene, voxels))


def test_denormals_and_the_largest_floats_keep_their_order(context: moderngl.Context) -> None:
    for scale in (5e-324 * 2**20, 1e-310, 1e-300, 1e300, 8e307):
        voxels = noise(dtype=np.float64) * scale
        scene = scene_of(voxels, camera_at("outside", GRID), clim=(-0.9 * scale, 0.9 * scale))
        assert error(context, scene, voxels) <= BOUND, scale


def test_values_far_outside_of_the_range_act_as_its_ends(context: moderngl.Context) -> None:
    """Within a cell that a far value touches, the field crosses the range too fast for any sample to see."""
    voxels = np.zeros(SHAPE, np.float64)
    voxels[:, :, 13:] = 1e200
    scene = scene_of(voxels, camera_at("outside", GRID), clim=(-1.0, 1.0), step=0.37)
    assert error(context, scene, voxels) <= BOUND


@pytest.mark.parametrize("opacity", [0.0, 1e-8, 1e-3, 0.5, 1 - 1e-8, 1.0])
def test_opacity_at_its_ends(context: moderngl.Context, opacity: float) -> None:
    voxels = noise(dtype=np.uint8)
    for step in (0.3, 1.0, 30.0):
        scene = scene_of(voxels, camera_at("outside", GRID), opacity=opacity, unit=1.0, step=step)
        expected = render_reference(scene, GRID, voxels)
        for found in pictures(context, scene, voxels):
            # A faint volume is held to its own scale.
            assert np.abs(found - expected).max() <= BOUND * max(expected.max(), 1e-30), f"step {step}"


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_opacity_unit_distance_at_its_ends(context: moderngl.Context, unit: float) -> None:
    voxels = noise(dtype=np.uint8)
    scene = scene_of(voxels, camera_at("outside", GRID), opacity=((0.0, 0.0), (1.0, 0.5)), unit=unit)
    expected = render_reference(scene, GRID, voxels)
    for found in pictures(context, scene, voxels):
        assert np.abs(found - expected).max() <= BOUND * expected.max()


@pytest.mark.parametrize("step", [1e-2, 1e-3])
@pytest.mark.parametrize(
    "opacity", [((0.0, 0.0), (1.0, 0.3)), ((0.0, 0.0), (1.0, 1.0)), 1e-3], ids=["linear", "opaque", "faint"]
)
def test_ten_thousand_short_slabs_add_up(context: moderngl.Context, opacity: Any, step: float) -> None:
    voxels = noise((9, 8, 11))
    scene = scene_of(
        voxels, camera_at("outside", Grid(voxels.shape)), opacity=opacity, unit=3.0, step=step, size=(6, 5)
    )
    assert error(context, scene, voxels) <= BOUND


@pytest.mark.parametrize("step", [1e2, 1e4])
def test_one_long_slab_through_all(context: moderngl.Context, step: float) -> None:
    voxels = noise(dtype=np.uint8)
    scene = scene_of(voxels, camera_at("outside", GRID), step=step)
    assert error(context, scene, voxels) <= BOUND
    drawn = draw(context, prepare(scene, voxels))
    assert drawn.samples <= 24 * 20


@pytest.mark.parametrize("points", [2, 1000])
def test_no_ray_is_cut_short_by_the_drivers_limit_of_loop_iterations(context: moderngl.Context, points: int) -> None:
    """Mesa's llvmpipe leaves all loops of an invocation after 65535 passes; 16 cells in steps of 1e-4 take 160000."""
    voxels = np.full((17, 17, 17), 0.5, np.float32)
    camera = Camera(position=(-50, 8, 8), focal_point=(8, 8, 8), view_up=(0, 0, 1), parallel_scale=2)
    close = 0.5 + np.linspace(-4e-5, 4e-5, points)  # all in one bucket of the transfer function
    opacity = ((0.0, 0.5), *((float(value), 0.5) for value in close), (1.0, 0.5))
    scene = scene_of(voxels, camera, clim=(0.0, 1.0), opacity=opacity, unit=16.0, step=1e-4, size=(3, 3))
    prepared = prepare(scene, voxels)
    for drawn in (draw(context, prepared), draw_on_cpu(prepared)):
        assert drawn.samples == 9 * 160_000
        assert np.abs(whole(drawn.partial, (3, 3))[..., 3] - 0.5).max() <= 1e-6


@pytest.mark.parametrize("residual", [0.01, 0.1, 0.5])
def test_early_termination_errs_by_the_residual_at_most_and_saves_samples(
    context: moderngl.Context, residual: float
) -> None:
    voxels = noise(dtype=np.uint8)
    camera = camera_at("outside", GRID)
    scene = scene_of(voxels, camera, opacity=0.9, early_termination=residual)
    full = draw(context, prepare(scene_of(voxels, camera, opacity=0.9), voxels))
    ended = draw(context, prepare(scene, voxels))
    difference = np.abs(whole(ended.partial, (24, 20)) - whole(full.partial, (24, 20))).max()
    assert 0 < difference <= residual
    assert ended.samples < full.samples


def test_no_early_termination_takes_every_sample(context: moderngl.Context) -> None:
    voxels = noise(dtype=np.uint8)
    camera = camera_at("outside", GRID)
    opaque, faint = (draw(context, prepare(scene_of(voxels, camera, opacity=a, unit=1.0), voxels)) for a in (0.5, 1e-6))
    assert opaque.samples == faint.samples
