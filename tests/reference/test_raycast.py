"""The reference against closed forms and one plain ray at a time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reference.scenes import SHAPE, along_x, one_volume, perspective, random_voxels, x_ramp

from clusterviz.data.source import Grid
from clusterviz.errors import InputError
from clusterviz.reference import raycast, render_reference
from clusterviz.scene.values import Scene

ALPHA_MAX = 1 - 2.0**-24


def one_pixel(scene: Scene, grid: Grid, voxels: np.ndarray, row: int, column: int) -> list[float]:
    """One ray, one number after another, in Python floats; axis-aligned grids and perspective only."""
    camera, (width, height) = scene.camera, scene.image.size
    volume, h = scene.volumes[0], scene.quality.step * min(grid.spacing)
    forward = np.subtract(camera.focal_point, camera.position) / math.dist(camera.focal_point, camera.position)
    right = np.cross(forward, camera.view_up)
    right /= math.hypot(*right)
    half = math.tan(math.radians(camera.view_angle / 2))
    u, v = (2 * (column + 0.5) / width - 1) * half * width / height, (1 - 2 * (row + 0.5) / height) * half
    ray = forward + u * right + v * np.cross(right, forward)
    ray /= math.hypot(*ray)
    last = [(n - 1) * s for n, s in zip(grid.shape_zyx[::-1], grid.spacing, strict=True)]
    hits = [
        sorted(((o - p) / r, (o + e - p) / r))
        for o, e, p, r in zip(grid.origin, last, camera.position, ray, strict=True)
    ]
    entry, leave = max(0.0, *(a for a, _ in hits)), min(b for _, b in hits)
    red, alpha, light, k = 0.0, 0.0, 1.0, 0
    while entry + k * h < leave:
        begin, end = entry + k * h, min(entry + (k + 1) * h, leave)
        point = [
            (p + (begin + end) / 2 * r - o) / s
            for p, r, o, s in zip(camera.position, ray, grid.origin, grid.spacing, strict=True)
        ]
        cell = [min(int(x), n - 2) for x, n in zip(point, grid.shape_zyx[::-1], strict=True)]
        scalar = 0.0
        for corner in np.ndindex(2, 2, 2):
            weight = math.prod((x - c) if o else 1 - (x - c) for x, c, o in zip(point, cell, corner, strict=True))
            scalar += weight * voxels[cell[2] + corner[2], cell[1] + corner[1], cell[0] + corner[0]]
        opacity = float(np.interp(scalar, *np.transpose(volume.opacity)))
        opaque = 1 - (1 - opacity) ** ((end - begin) / volume.opacity_unit_distance)
        red += light * opaque * float(np.interp(scalar, *np.transpose(volume.cmap)[:2]))
        alpha += light * opaque
        light *= 1 - opaque
        k += 1
    return [red, alpha]


@pytest.mark.parametrize("step", [0.3, 1.0, 2.0])
def test_every_pixel_equals_a_ray_marched_by_hand(step: float) -> None:
    grid = Grid(SHAPE, spacing=(0.5, 0.75, 1.25), origin=(3, -2, 1))
    camera = perspective((9, -6, 7), (4, -0.5, 2.9), angle=40)
    scene = one_volume(camera, size=(8, 6), step=step, unit=0.7)
    rgba = render_reference(scene, grid, random_voxels())
    drawn = 0
    for row, column in np.ndindex(6, 8):
        expected = one_pixel(scene, grid, random_voxels(), row, column)
        assert rgba[row, column, [0, 3]] == pytest.approx(expected, rel=1e-12, abs=1e-14)
        drawn += expected[1] > 0
    assert 10 < drawn < 48


@pytest.mark.cover
@pytest.mark.parametrize("step", [1e-3, 0.3, 1.0, 2.5, 100.0])
def test_a_homogeneous_slab_is_exact_at_every_step(step: float) -> None:
    scene = one_volume(along_x(), opacity=0.3, unit=2.0, size=(1, 1))
    rgba = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.25), step)[0, 0]
    alpha = 1 - 0.7 ** (5 / 2)
    assert rgba == pytest.approx(np.array([0.75, 0.25, 0.25, 1]) * alpha, rel=1e-12)


@pytest.mark.parametrize("opacity", [1e-8, 0.5, 1 - 1e-8, 1.0])
def test_opacities_at_both_ends_keep_all_digits(opacity: float) -> None:
    scene = one_volume(along_x(), opacity=opacity, unit=5.0, size=(1, 1))
    alpha = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.25), 0.125)[0, 0, 3]
    assert alpha == pytest.approx(min(opacity, ALPHA_MAX), rel=1e-13, abs=0)


def test_opacity_0_draws_nothing_at_all() -> None:
    scene = one_volume(along_x(), opacity=0.0)
    assert not render_reference(scene, Grid(SHAPE), random_voxels()).any()


@pytest.mark.long
def test_ten_thousand_thin_slabs_do_not_drift() -> None:
    scene = one_volume(along_x(), opacity=1e-8, unit=5.0, size=(1, 1))
    alpha = render_reference(scene, Grid(SHAPE), np.full(SHAPE, 0.25), 5e-4)[0, 0, 3]
    assert alpha == pytest.approx(1e-8, rel=1e-11, abs=0)


def test_a_smooth_field_seen_aslant_converges_with_order_2() -> None:
    """Random voxels have kinks at the cells' faces, where the midpoint rule is of order 2 only on average."""
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)), size=(6, 6))
    finest, coarse, fine = (render_reference(scene, Grid(SHAPE), random_voxels(), h) for h in (1 / 128, 1, 1 / 16))
    assert 1.7 < math.log2(np.abs(coarse - finest).mean() / np.abs(fine - finest).mean()) / 4 < 2.3


def test_the_last_slab_is_cut_and_sampled_at_its_own_midpoint() -> None:
    scene = one_volume(along_x(), opacity=1.0, unit=1e-6, size=(1, 1))
    rgba = render_reference(scene, Grid((4, 5, 6)), x_ramp(), 100.0)[0, 0]
    assert rgba == pytest.approx([0.5, 0.25, 0.5, 1], abs=1e-12)
    only_the_far_end = one_volume(along_x(), opacity=((0.0, 0.0), (0.79, 0.0), (0.8, 1.0)), unit=1e-6, size=(1, 1))
    rgba = render_reference(only_the_far_end, Grid((4, 5, 6)), x_ramp(), 4.0)[0, 0]
    assert rgba == pytest.approx([0.1, 0.25, 0.9, 1], abs=1e-12)


def test_a_nearly_black_ray_may_end_but_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)), opacity=((0.0, 0.0), (1.0, 1.0)), unit=0.1, step=0.1)
    a = render_reference(scene, Grid(SHAPE), random_voxels())
    monkeypatch.setattr(raycast, "DARK", -1)
    assert np.abs(a - render_reference(scene, Grid(SHAPE), random_voxels())).max() < 1e-15


def test_how_many_rays_are_marched_at_once_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)))
    a = render_reference(scene, Grid(SHAPE), random_voxels())
    monkeypatch.setattr(raycast, "RAYS_AT_ONCE", 6)
    assert np.array_equal(a, render_reference(scene, Grid(SHAPE), random_voxels()))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1)])
def test_pictures_of_one_pixel_row_or_column(size: tuple[int, int]) -> None:
    rgba = render_reference(
        one_volume(perspective((12, -9, 8), (2.5, 2, 1.5)), size=size), Grid(SHAPE), random_voxels()
    )
    assert rgba.shape == (size[1], size[0], 4)
    assert rgba[size[1] // 2, size[0] // 2, 3] > 0.5


def test_a_scene_without_volumes_is_transparent() -> None:
    scene = Scene(camera=along_x())
    assert not render_reference(scene, Grid(SHAPE), random_voxels()).any()


@pytest.mark.parametrize("step", [0.0, -1.0, math.nan, math.inf])
def test_impossible_steps_are_refused(step: float) -> None:
    with pytest.raises(InputError, match="step"):
        render_reference(one_volume(along_x()), Grid(SHAPE), random_voxels(), step)


def test_voxels_of_another_shape_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(4, 5, 6\)"):
        render_reference(one_volume(along_x()), Grid(SHAPE), random_voxels()[1:])
