"""Looks at the ends of what a volume may be: thin, tiny, empty, steep, in other units of length, seen from inside."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
import pytest
from render.scenes import SHAPE, camera_at, noise, prepare, scene_of
from render.test_projections import projected
from render.test_shading import LIT, smooth

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference

pytestmark = pytest.mark.gl

BOUND = 1e-4
LOOKS: dict[str, dict[str, Any]] = {
    "maximum": {"look": {"blending": "maximum"}},
    "minimum": {"look": {"blending": "minimum"}},
    "local-maximum": {"look": {"blending": "local-maximum", "threshold": 0.6}},
    "first-hit": {"look": {"blending": "first-hit", "threshold": 0.6}},
    "average": {"look": {"blending": "average"}},
    "additive": {"look": {"blending": "additive"}},
    "shade": {"look": LIT},
    "cubic": {"interpolation": "cubic", "look": LIT},
    "isosurface": {"look": LIT | {"blending": "isosurface", "isosurfaces": [(0.5, 0.5)]}},
    "isosurface in a volume": {"interpolation": "cubic", "look": LIT | {"isosurfaces": [(0.5, 0.5)]}},
}


def error(
    context: moderngl.Context, name: str, voxels: np.ndarray, camera: str, grid: Grid | None = None, **keys: Any
) -> float:
    """Largest difference from the reference, but for one pixel in a hundred, where a surface may only just be met."""
    grid = grid or Grid(voxels.shape)
    brick = keys.pop("brick", 7)
    scene = scene_of(voxels, camera_at(camera, grid), clim=(0.0, 1.0), **(LOOKS[name] | keys))
    found, _ = projected(context, scene, prepare(scene, voxels, grid, brick))
    difference = np.abs(found - render_reference(scene, grid, voxels)).max(axis=-1)
    assert np.isfinite(found).all()
    return float(np.quantile(difference, 0.99 if "iso" in name else 1.0, method="lower"))


@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("shape", [(1, 9, 9), (9, 9, 1), (1, 1, 1)])
def test_volume_without_thickness_is_an_empty_picture(
    context: moderngl.Context, name: str, shape: tuple[int, int, int]
) -> None:
    scene = scene_of(np.full(shape, 0.5), camera_at("outside", Grid((9, 9, 9))), clim=(0.0, 1.0), **LOOKS[name])
    assert not projected(context, scene, prepare(scene, np.full(shape, 0.5)))[0].any()


@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("shape", [(2, 2, 2), (2, 9, 5), (9, 2, 2)])
def test_one_cell_is_enough(context: moderngl.Context, name: str, shape: tuple[int, int, int]) -> None:
    assert error(context, name, smooth(shape), "outside", unit=1.0, step=0.23) <= BOUND


@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("camera", ["on-a-corner", "on-an-edge", "along-an-axis", "far", "parallel-from-inside"])
def test_every_place_of_the_eye(context: moderngl.Context, name: str, camera: str) -> None:
    assert error(context, name, smooth(), camera, step=0.83) <= BOUND


@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("brick", [2, 64])
def test_smallest_and_largest_bricks(context: moderngl.Context, name: str, brick: int) -> None:
    assert error(context, name, smooth(), "outside", brick=brick) <= BOUND


@pytest.mark.parametrize("name", LOOKS)
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_units_of_length(context: moderngl.Context, name: str, unit: float) -> None:
    grid = Grid(SHAPE, (unit, 1.5 * unit, 0.7 * unit), (3 * unit, 0.0, -unit))
    assert error(context, name, smooth(), "outside", grid, unit=8 * unit) <= BOUND


@pytest.mark.parametrize("name", LOOKS)
def test_volume_of_invalid_voxels_is_an_empty_picture(context: moderngl.Context, name: str) -> None:
    voxels = np.full(SHAPE, np.nan, np.float32)
    scene = scene_of(voxels, camera_at("outside", Grid(SHAPE)), clim=(0.0, 1.0), **LOOKS[name])
    assert not projected(context, scene, prepare(scene, voxels))[0].any()


@pytest.mark.parametrize("name", LOOKS)
def test_values_far_outside_of_the_range(context: moderngl.Context, name: str) -> None:
    """Fields that cross the range within a millionth of a cell; what is seen there is open, but it is a number."""
    voxels = noise(dtype=np.float64)
    voxels[:, :, 13:] *= 1e200
    scene = scene_of(voxels, camera_at("outside", Grid(SHAPE)), clim=(0.0, 1.0), **LOOKS[name])
    found, _ = projected(context, scene, prepare(scene, voxels))
    assert np.isfinite(found).all()
    assert found.min() >= -1e-6
    assert found.max() <= 1 + 1e-6
