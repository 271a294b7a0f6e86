"""The picture against the float64 reference, for everything that a scene or a file may vary.

The bound is 1e-5 of full scale for float32 weights (what is seen is near 1e-6). The texture unit's filter has a bound
of its own: it may round weights to 8 bits, and 8- and 16-bit voxels to as few.
"""

from __future__ import annotations

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
    pictures,
    prepare,
    rotation,
    scene_of,
    whole,
)

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference

pytestmark = pytest.mark.gl

BOUND = 1e-5
HARDWARE_BOUND = 0.03
DTYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float16", "float32", "float64")
GRID = Grid(SHAPE)
# No slab's midpoint is half-way between voxels, where the nearest voxel is a matter of the last bit: along an axis the
# midpoints are at 0.7 k + 0.35, never at m + 0.5.
STEPS = {"linear": (2.0, 1.0, 0.25), "nearest": (2.2, 0.7, 0.26)}


def worst(context: moderngl.Context, scene: object, voxels: np.ndarray, grid: Grid = GRID, brick: int = 16) -> float:
    """Largest difference from the reference, of every caster's pictures, which show something."""
    expected = render_reference(scene, grid, voxels)
    assert expected[..., 3].max() > 0.3, "the scene shows nothing that could be wrong"
    return max(float(np.abs(found - expected).max()) for found in pictures(context, scene, voxels, grid, brick))


@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_every_type_over_its_whole_range(context: moderngl.Context, dtype: str, interpolation: str) -> None:
    voxels = noise(dtype=dtype)
    scene = scene_of(voxels, camera_at("outside", GRID), interpolation=interpolation, step=0.9)
    assert worst(context, scene, voxels) <= BOUND


@pytest.mark.parametrize("dtype", DTYPES)
def test_texture_filter_keeps_its_own_bound(context: moderngl.Context, dtype: str) -> None:
    voxels = noise(dtype=dtype)
    scene = scene_of(voxels, camera_at("outside", GRID), step=0.9, filter="hardware")
    assert worst(context, scene, voxels) <= HARDWARE_BOUND


@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
@pytest.mark.parametrize("camera", CAMERAS)
def test_every_camera_at_every_step(context: moderngl.Context, camera: str, interpolation: str) -> None:
    voxels = noise(dtype="uint8")
    for step in STEPS[interpolation]:
        scene = scene_of(voxels, camera_at(camera, GRID), interpolation=interpolation, step=step)
        assert worst(context, scene, voxels) <= BOUND, f"step {step}"


@pytest.mark.parametrize("brick", [2, 5, 16, 33, 64])
@pytest.mark.parametrize("dtype", ["uint8", "int16", "float32"])
@pytest.mark.parametrize("camera", ["outside", "inside"])
def test_every_brick_size(context: moderngl.Context, camera: str, dtype: str, brick: int) -> None:
    voxels = noise(dtype=dtype)
    scene = scene_of(voxels, camera_at(camera, GRID), step=0.5)
    assert worst(context, scene, voxels, brick=brick) <= BOUND


TURNED = rotation((1.0, 2.0, -0.5), 37.0)
GRIDS = {
    "anisotropic": Grid(SHAPE, (0.4, 1.7, 0.9), (5.0, -3.0, 2.0)),
    "turned": Grid(SHAPE, (1.0, 1.0, 1.0), (-7.0, 3.0, 1.0), TURNED),
    "turned-and-anisotropic": Grid(SHAPE, (1.3, 0.6, 2.0), (100.0, -50.0, 3.0), TURNED),
    "mirrored": Grid(SHAPE, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
    "axes-exchanged": Grid(
        SHAPE, (1.0, 2.0, 1.0), (0.0, 0.0, 0.0), ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    ),
    "nanometres": Grid(SHAPE, (1e-9, 1.5e-9, 1e-9), (3e-9, 0.0, 1e-8)),
    "gigametres": Grid(SHAPE, (1e9, 1.5e9, 1e9), (3e9, 0.0, 1e10)),
    "far-from-the-origin": Grid(SHAPE, (1.0, 1.0, 1.0), (1e6, -1e6, 3e6)),
}


@pytest.mark.parametrize("camera", ["outside", "inside", "parallel"])
@pytest.mark.parametrize("name", GRIDS)
def test_every_grid(context: moderngl.Context, name: str, camera: str) -> None:
    voxels, grid = noise(dtype="uint16"), GRIDS[name]
    scene = scene_of(voxels, camera_at(camera, grid), unit=8 * min(grid.spacing))
    assert worst(context, scene, voxels, grid) <= BOUND


@pytest.mark.parametrize("size", [(1, 1), (1, 17), (17, 1), (8, 8), (9, 31)])
def test_every_picture_size(context: moderngl.Context, size: tuple[int, int]) -> None:
    voxels = noise(dtype="uint8")
    assert worst(context, scene_of(voxels, camera_at("outside", GRID), size=size), voxels) <= BOUND


def test_narrow_range_of_large_values_keeps_its_digits(context: moderngl.Context) -> None:
    for dtype, middle in (("float64", 3e5), ("float64", 1e300), ("int64", 2**40), ("uint16", 40000)):
        values = np.random.default_rng(3).integers(-100, 101, SHAPE)
        width = {"float64": middle * 2.0**-40}.get(dtype, 1.0)
        voxels = (np.asarray(middle, dtype) + (values * width).astype(dtype)).astype(dtype)
        scene = scene_of(voxels, camera_at("outside", GRID), clim=(middle - 70 * width, middle + 70 * width))
        assert worst(context, scene, voxels) <= BOUND, dtype


def test_footprint_holds_all_that_is_drawn_and_little_more(context: moderngl.Context) -> None:
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at("outside", GRID), size=(64, 48), opacity=0.5)
    prepared = prepare(scene, voxels)
    rect = draw(context, prepared).partial.rect
    assert draw_on_cpu(prepared).partial.rect == rect
    rows, columns = np.nonzero(render_reference(scene, GRID, voxels)[..., 3])
    spare = (columns.min() - rect.x_begin, rows.min() - rect.y_begin)
    spare += (rect.x_end - columns.max() - 1, rect.y_end - rows.max() - 1)
    # One pixel for rounding, and one or two whose centres a pointed corner misses.
    assert all(0 <= pixels <= 3 for pixels in spare), spare


def test_samples_are_counted_once_each(context: moderngl.Context) -> None:
    """All rays run along x: 25 cells are 50 slabs of half a cell."""
    voxels = noise(dtype="uint8")
    scene = scene_of(voxels, camera_at("parallel-along-an-axis", GRID), opacity=1e-6, step=0.5, size=(12, 10))
    drawn = draw(context, prepare(scene, voxels))
    rays = np.count_nonzero(whole(drawn.partial, (12, 10))[..., 3])
    assert rays > 0
    assert drawn.samples == rays * 50
    assert draw_on_cpu(prepare(scene, voxels)).samples == rays * 50
