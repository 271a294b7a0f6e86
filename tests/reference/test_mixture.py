"""The reference of several volumes against closed forms, and against the reference of one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clusterviz.data.source import Grid
from clusterviz.reference import render_reference
from clusterviz.scene.values import Camera, ImageSettings, Quality, Scene, Volume

GRID = Grid((7, 8, 9))
VOXELS = np.random.default_rng(2).random(GRID.shape_zyx)
TURN = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
AXIS = Camera(position=(2.0, 2.0, -20.0), focal_point=(2.0, 2.0, 0.0), view_up=(0, 1, 0), parallel_scale=0.5)
ASIDE = Camera(position=(18.0, 13.0, 15.0), focal_point=(4.0, 3.0, 3.0), view_up=(0, 0, 1))


def volume(colour: tuple[float, float, float] = (1.0, 0.5, 0.0), opacity: Any = 0.3, **keys: Any) -> Volume:
    cmap = ((0.0, 0.0, 0.2, 0.4), (1.0, *colour))
    return Volume(path="a", cmap=cmap, clim=(0.0, 1.0), opacity=opacity, opacity_unit_distance=2.0, **keys)


def scene_of(*volumes: Volume, camera: Camera = ASIDE, size: tuple[int, int] = (20, 16), step: float = 0.5) -> Scene:
    scene = Scene(volumes=(), camera=camera, image=ImageSettings(size=size), quality=Quality(step=step))
    return scene.model_copy(update={"volumes": volumes})


def mixed(scene: Scene, *parts: tuple[Grid, np.ndarray]) -> np.ndarray:
    return render_reference(scene, [grid for grid, _ in parts], [voxels for _, voxels in parts])


def test_homogeneous_boxes_absorb_by_the_sum_of_their_extinctions_and_glow_by_their_share() -> None:
    """Along the axis: 2 units of the first alone, 2 of both, 3 of the second; the steps meet the faces."""
    first, second = Grid((5, 5, 5)), Grid((6, 5, 5), origin=(0.0, 0.0, 2.0))
    red, blue = volume((1.0, 0.0, 0.0), 0.3), volume((0.0, 0.0, 1.0), 0.6)
    ones = np.ones((5, 5, 5)), np.ones((6, 5, 5))
    scene = scene_of(red, blue, camera=AXIS, size=(1, 1))
    found = mixed(scene, (first, ones[0]), (second, ones[1]))[0, 0]
    kappa, colours = -np.log1p([-0.3, -0.6]) / 2, np.eye(3)[[0, 2]]
    through, expected = 1.0, np.zeros(3)
    for length, inside in ((2.0, [1, 0]), (2.0, [1, 1]), (3.0, [0, 1])):
        total = (kappa * inside).sum()
        share = (kappa * inside) @ colours / total
        expected += through * -np.expm1(-total * length) * share
        through *= np.exp(-total * length)
    assert np.allclose(found, [*expected, 1 - through], rtol=0, atol=1e-13)


def test_rays_that_never_meet_a_volume_are_none_of_its_slabs_ends() -> None:
    """Along the axis, beside the second volume: they would meet it at infinity."""
    scene = scene_of(volume(), volume(), camera=AXIS, size=(1, 1))
    quality = scene.quality.model_copy(update={"classification": "pre-integrated"})
    scene = scene.model_copy(update={"quality": quality})
    parts = (Grid((5, 5, 5)), np.ones((5, 5, 5))), (Grid((5, 5, 5), origin=(9.0, 0.0, 0.0)), np.ones((5, 5, 5)))
    found = mixed(scene, *parts)[0, 0]
    assert np.allclose(found[3], 1 - 0.7**2, rtol=0, atol=1e-13)


def test_a_volume_given_twice_is_one_of_twice_the_extinction() -> None:
    once = volume(opacity=((0.0, 0.0), (1.0, 0.5)))
    found = mixed(scene_of(once, once), (GRID, VOXELS), (GRID, VOXELS))
    halved = once.model_copy(update={"opacity_unit_distance": 1.0})
    assert np.allclose(found, render_reference(scene_of(halved), GRID, VOXELS), rtol=0, atol=1e-13)


def test_one_alone_is_as_before_and_a_transparent_one_inside_changes_nothing() -> None:
    alone = render_reference(scene_of(volume()), GRID, VOXELS)
    assert np.array_equal(render_reference(scene_of(volume()), [GRID], [VOXELS]), alone)
    inside = Grid((3, 4, 5), origin=(2.0, 2.0, 2.0))
    found = mixed(scene_of(volume(), volume(opacity=0.0)), (GRID, VOXELS), (inside, np.ones((3, 4, 5))))
    assert np.allclose(found, alone, rtol=0, atol=1e-13)


def test_the_order_of_volumes_is_of_no_account() -> None:
    turned = Grid((5, 6, 4), (1.5, 1.1, 0.9), (3.0, 1.0, 2.0), TURN)
    other = VOXELS[:5, :6, :4]
    a, b = volume(shade=True), volume((0.0, 1.0, 1.0), interpolation="nearest")
    one = mixed(scene_of(a, b), (GRID, VOXELS), (turned, other))
    assert one[..., 3].max() > 0.5
    assert np.allclose(mixed(scene_of(b, a), (turned, other), (GRID, VOXELS)), one, rtol=0, atol=1e-13)


def test_what_is_invalid_in_one_hides_nothing_of_another() -> None:
    hollow = np.full(GRID.shape_zyx, np.nan)
    found = mixed(scene_of(volume(), volume()), (GRID, VOXELS), (GRID, hollow))
    assert np.allclose(found, render_reference(scene_of(volume()), GRID, VOXELS), rtol=0, atol=1e-13)


def test_a_flat_volume_shows_nothing_but_is_part_of_the_box() -> None:
    flat = Grid((1, 8, 9), origin=(0.0, 0.0, -0.25))
    found = mixed(scene_of(volume(), volume()), (GRID, VOXELS), (flat, np.ones(flat.shape_zyx)))
    alone = render_reference(scene_of(volume()), GRID, VOXELS)
    assert 1e-6 < np.abs(found - alone).max() < 0.05  # slabs begin elsewhere


def test_surfaces_of_one_of_two_volumes_are_those_of_one_alone() -> None:
    """The other is transparent, and in the same box."""
    look = {"isosurfaces": (0.4, (0.6, 0.7)), "shade": True}
    for blending in ("composite", "isosurface"):
        one = volume(blending=blending, **look)
        alone = render_reference(scene_of(one), GRID, VOXELS)
        found = mixed(scene_of(volume(opacity=0.0), one), (GRID, VOXELS), (GRID, VOXELS))
        assert alone[..., 3].max() > 0.5
        assert np.allclose(found, alone, rtol=0, atol=1e-9)


def test_where_surfaces_of_two_volumes_meet_the_nearer_one_is_in_front() -> None:
    """Along the axis through two ramps: opaque planes a quarter of a slab apart."""
    ramp = np.broadcast_to(np.arange(5.0)[:, None, None] / 4, (5, 5, 5)).copy()
    near = volume((1.0, 0.0, 0.0), isosurfaces=((0.55, 1.0),), blending="isosurface")
    far = volume((0.0, 0.0, 1.0), isosurfaces=((0.6, 1.0),), blending="isosurface")
    for volumes in ((near, far), (far, near)):
        scene = scene_of(*volumes, camera=AXIS, size=(1, 1), step=1.0)
        found = mixed(scene, (Grid((5, 5, 5)), ramp), (Grid((5, 5, 5)), ramp))[0, 0]
        share = 0.55
        assert np.allclose(found[:3], (1 - share) * np.array([0, 0.2, 0.4]) + share * np.array([1, 0, 0]), atol=1e-9)


def preintegrated(scene: Scene) -> Scene:
    return scene.model_copy(update={"quality": scene.quality.model_copy(update={"classification": "pre-integrated"})})


def test_integrals_of_a_faint_volume_are_those_of_one_alone_and_all_opacities_are() -> None:
    """In which order a slab absorbs is of account in the square of its depth only, and for colours only."""
    for opacity, colours in ((1e-4, 1e-9), (((0.0, 0.0), (0.4, 0.0), (0.5, 0.9), (0.6, 0.0)), 0.05)):
        one = volume(opacity=opacity)
        alone = render_reference(preintegrated(scene_of(one)), GRID, VOXELS)
        scene = preintegrated(scene_of(volume(opacity=0.0), one))
        apart = np.abs(mixed(scene, (GRID, VOXELS), (GRID, VOXELS)) - alone)
        assert alone[..., 3].max() > 3e-4
        assert apart[..., 3].max() <= 1e-12
        assert apart[..., :3].max() <= colours


@pytest.mark.long
def test_integrals_converge_with_the_square_of_the_step_and_sooner_than_midpoints_where_opacity_has_a_peak() -> None:
    """Smooth fields on turned grids, one of which begins within the other."""
    axes = np.indices((9, 9, 9)) / 4 - 1
    blob = np.exp(-(axes**2).sum(axis=0))
    peak = ((0.0, 0.0), (0.45, 0.0), (0.5, 0.8), (0.55, 0.0))
    parts = (Grid((9, 9, 9)), blob), (Grid((9, 9, 9), (0.7, 0.8, 0.6), (3.0, 1.2, 1.0), TURN), blob)
    scene = scene_of(volume(opacity=peak), volume((0.0, 0.3, 1.0), peak), size=(10, 8))
    at = lambda scene, step: render_reference(scene, [g for g, _ in parts], [v for _, v in parts], step)  # noqa: E731
    truth = at(preintegrated(scene), 1 / 32)
    rms = [float(np.sqrt(np.mean((at(preintegrated(scene), step) - truth) ** 2))) for step in (1, 1 / 2, 1 / 4)]
    midpoints = float(np.sqrt(np.mean((at(scene, 1 / 2) - truth) ** 2)))
    assert rms[0] / rms[1] > 3
    assert rms[1] / rms[2] > 3
    assert rms[1] < midpoints / 3
