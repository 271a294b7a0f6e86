"""Sub-images of a lens: ranges of depth whose circles of confusion differ little."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clusterviz.data.source import Grid
from clusterviz.plan.lens import SPACING, make_lens
from clusterviz.plan.view import make_view
from clusterviz.scene.camera import project_points
from clusterviz.scene.lens import eye_points, lens_points
from clusterviz.scene.overrides import with_settings
from clusterviz.scene.values import Camera, Scene

GRID = Grid((11, 11, 21))
CAMERA = Camera(position=(-9, 5, 5), focal_point=(10, 5, 5), view_up=(0, 0, 1))


@pytest.mark.parametrize("most", [3, 5, 16, 128])
@pytest.mark.parametrize("aperture", [1e-6, 0.3, 3.0, 1e4])
@pytest.mark.parametrize(("eye", "focus"), [(-9.0, 12.0), (-9.0, 1e-3), (-9.0, 1e6), (5.0, 7.0), (-1e6, 1e6 + 8)])
def test_radii_are_those_of_the_depths_within_the_bound(eye: float, focus: float, aperture: float, most: int) -> None:
    keys = {"aperture": aperture, "focal_distance": focus, "position": (eye, 5, 5), "lens": {"sub_images": most}}
    scene = with_settings(Scene(camera=CAMERA), {**keys, "size": (64, 48)})
    view = make_view(scene.camera, (64, 48), GRID)
    lens = make_lens(scene, view, (20.0, 10.0, 10.0))
    assert lens is not None
    assert 1 <= lens.count <= most
    assert (np.diff(lens.radii) > 0).all()
    assert (np.diff(lens.depths) >= 0).all()
    # What a sub-image holds is blurred by the middle of it, or not at all.
    ends = aperture / view.pixel * (1 / focus - 1 / np.array([max(-eye, 1e-9), 20 - eye]))
    true = np.linspace(*np.clip(ends, -64, 64), 4001)
    depths = 1 / (1 / focus - true * view.pixel / aperture)
    number = np.clip(np.searchsorted(lens.depths, depths, "right") - 1, 0, lens.count - 1)
    slack = np.ptp(true) / 1000 + 1e-6
    for one in np.unique(number[1:-1]):
        held, radius = true[number == one], lens.radii[one]
        bound = 0.5 * SPACING if radius == 0 else 0.5 * np.ptp(held)
        assert np.abs(held - radius).max() <= bound + slack
    if most == 128:
        assert np.abs(true - lens.radii[number]).max() <= 0.5 * SPACING + slack
    # Planes are at the depths, and the margin leaves the rays as they are.
    rows = lens.planes(lens.view(view))
    assert rows.shape == (2, 4)
    inner, outer = lens.view(view), view
    assert np.allclose(np.subtract(inner.centre, lens.margin), outer.centre, atol=1e-9)


def test_points_of_a_lens_have_the_moments_of_a_disc() -> None:
    assert lens_points(1).tolist() == [[0.0, 0.0]]
    for count in (2, 3, 16, 100):
        points = lens_points(count)
        assert points.shape == (count, 2)
        assert len(np.unique(points.round(12), axis=0)) == count
        assert np.hypot(*points.T).max() <= 1
        assert np.abs(points.mean(axis=0)).max() <= 0.6 / math.sqrt(count)
    np.testing.assert_allclose(np.cov(lens_points(1024).T, bias=True), np.eye(2) / 4, atol=0.01)


def test_eye_points_meet_on_the_plane_in_focus() -> None:

    scene = with_settings(Scene(camera=CAMERA), {"aperture": 2.0, "focal_distance": 8.0, "window_center": (0.2, 0.1)})
    on_plane = np.array([[-1.0, 5.0, 5.0], [-1.0, 6.0, 4.5], [-1.0, 3.0, 5.7]])
    expected, _ = project_points(scene.camera, on_plane, (64, 48))
    for one in eye_points(scene, 9):
        assert one.camera.aperture == 0
        np.testing.assert_allclose(project_points(one.camera, on_plane, (64, 48))[0], expected, atol=1e-9)
