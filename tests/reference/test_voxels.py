"""The reference and its voxels: bad ones, nearest ones, and those of every type."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference.scenes import RAMP, RED_TO_BLUE, SHAPE, along_x, one_volume, perspective, random_voxels

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_cells_that_touch_a_bad_voxel_are_transparent_and_no_others(bad: float) -> None:
    voxels = np.full((4, 4, 8), 0.5)
    voxels[1, 1, 3] = bad
    for y, length in ((1.5, 5), (0.5, 5), (2.5, 7), (2.0000001, 7), (1.9999999, 5)):
        scene = one_volume(along_x(1e-9, y=y, z=0.5), opacity=0.2, size=(1, 1))
        rgba = render_reference(scene, Grid(voxels.shape), voxels, 0.25)[0, 0]
        assert rgba[3] == pytest.approx(1 - 0.8**length, abs=1e-12)
        assert np.isfinite(rgba).all()


def test_nearest_loses_only_the_half_cells_around_a_bad_voxel() -> None:
    voxels = np.full((4, 4, 8), 0.5)
    voxels[1, 1, 3] = math.nan
    for y, length in ((1.4, 6), (1.6, 7), (0.6, 6), (0.4, 7)):
        scene = one_volume(along_x(1e-9, y=y, z=0.75), opacity=0.2, size=(1, 1), interpolation="nearest")
        alpha = render_reference(scene, Grid(voxels.shape), voxels, 0.25)[0, 0, 3]
        assert alpha == pytest.approx(1 - 0.8**length, abs=1e-12)


def test_nearest_shows_blocks_of_constant_scalar() -> None:
    scene = one_volume(along_x(1e-9, y=1.4, z=0.6), size=(1, 1), interpolation="nearest")
    voxels = random_voxels()
    alpha = render_reference(scene, Grid(SHAPE), voxels, 0.125)[0, 0, 3]
    opacity = np.interp(voxels[1, 1], *np.transpose(RAMP))
    lengths = np.array([0.5, 1, 1, 1, 1, 0.5])
    assert alpha == pytest.approx(1 - np.prod((1 - opacity) ** lengths), rel=1e-12)


@pytest.mark.parametrize("dtype", ["i1", "u1", ">i2", "u2", "i4", "u4", "<i8", "u8", "f2", ">f4", "f4", ">f8"])
def test_every_type_and_byte_order_draws_its_values(dtype: str) -> None:
    voxels = np.random.default_rng(2).integers(0, 100, SHAPE)
    points = tuple((s * 100, a) for s, a in RAMP)
    colours = tuple((s * 100, *rgb) for s, *rgb in RED_TO_BLUE)
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)), opacity=points, cmap=colours)
    a = render_reference(scene, Grid(SHAPE), voxels.astype(dtype))
    b = render_reference(scene, Grid(SHAPE), voxels.astype(np.float64))
    assert a[..., 3].max() > 0.5
    assert np.array_equal(a, b)
