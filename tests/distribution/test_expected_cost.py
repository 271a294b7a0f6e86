"""Expected samples against counts of the slabs of every ray."""

from __future__ import annotations

import numpy as np
import pytest

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.summary import VolumeSummary
from clusterviz.distribution.brick_cost import expected_samples
from clusterviz.image.partial import Rect
from clusterviz.plan.content import KnownVolume
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.scene.values import Camera, ImageSettings, Scene, Volume

LAYOUT = BrickLayout((25, 33, 41), 8)  # 3 × 4 × 5 bricks
SPACING = (1.0, 1.5, 0.8)
CENTRE = (20.0, 24.0, 9.6)
OUTSIDE = {
    "far": Camera(position=(150, 120, 90), focal_point=CENTRE, view_up=(0, 0, 1)),
    "near, cut by the picture": Camera(position=(80, 40, 40), focal_point=(10, 30, 9), view_up=(0, 1, 1)),
    "parallel": Camera(position=(100, 90, 80), focal_point=CENTRE, view_up=(0, 0, 1), parallel_scale=30.0),
}


def plan_of(camera: Camera, hidden: np.ndarray | None = None) -> Plan:
    high = np.where(np.zeros(LAYOUT.counts_zyx, bool) if hidden is None else hidden, -1.0, 1.0)
    summary = VolumeSummary(np.full(high.shape, -1.0), high, np.ones(4, np.int64), (0.0, 1.0), ())
    grey = ((0.0, 0, 0, 0), (1.0, 1, 1, 1))
    opacity = ((0.0, 0.0), (1.0, 0.5))
    volume = Volume(path="in memory", cmap=grey, clim=(0.0, 1.0), opacity=opacity, opacity_unit_distance=4.0)
    scene = Scene(volumes=(volume,), camera=camera, image=ImageSettings(size=(80, 60)))
    source = ArraySource(np.zeros(LAYOUT.shape_zyx, np.float32), Grid(LAYOUT.shape_zyx, SPACING))
    return make_plan(scene, [KnownVolume(source, LAYOUT, summary)])


def counted(plan: Plan) -> np.ndarray:
    """Midpoints of slabs in each brick."""
    view, samples = plan.view, np.zeros(plan.cost.shape)
    right, up, forward = (np.array(axis) for axis in (view.right, view.up, view.forward))
    times = (np.arange(4000) + 0.5) * plan.march.step_world
    cells = np.array(LAYOUT.cells_zyx[::-1])
    for row in range(view.size[1]):
        for column in range(view.size[0]):
            x = (column + 0.5 - view.size[0] / 2) * view.pixel
            y = -(row + 0.5 - view.size[1] / 2) * view.pixel
            aside = x * right + y * up
            start = np.array(view.eye) + (aside if view.parallel else 0)
            along = forward if view.parallel else (forward + aside) / np.sqrt(1 + x * x + y * y)
            points = start + times[:, None] * along
            inside = points[((points >= 0) & (points < cells)).all(axis=1)]
            np.add.at(samples, tuple((inside // LAYOUT.brick).astype(int).T[::-1]), 1)
    return samples


@pytest.mark.cover
@pytest.mark.parametrize("camera", OUTSIDE.values(), ids=OUTSIDE.keys())
def test_expected_samples_are_those_of_the_rays_and_windows_divide_them(camera: Camera) -> None:
    plan = plan_of(camera)
    expected, truth = expected_samples(plan), counted(plan)
    assert expected.sum() == pytest.approx(truth.sum(), rel=0.03)
    # A brick that the border of the picture cuts is known by 27 points only.
    assert np.abs(expected - truth).max() < 0.15 * truth.max()
    windows = Rect(0, 0, 40, 60), Rect(40, 0, 80, 30), Rect(40, 30, 80, 60)
    parts = [expected_samples(plan, window) for window in windows]
    np.testing.assert_allclose(np.sum(parts, axis=0), expected)
    assert all(0 < part.sum() < 0.8 * expected.sum() for part in parts)
    assert not expected_samples(plan, Rect(9, 9, 9, 9)).any()


def test_the_total_is_roughly_right_from_inside() -> None:
    plan = plan_of(Camera(position=CENTRE, focal_point=(0, 0, 0), view_up=(0, 0, 1)))
    assert expected_samples(plan).sum() == pytest.approx(counted(plan).sum(), rel=0.5)


def test_hidden_bricks_those_behind_the_eye_and_nothing_to_show_cost_nothing() -> None:
    hidden = np.zeros(LAYOUT.counts_zyx, bool)
    hidden[1, 2, 3] = True
    assert (expected_samples(plan_of(OUTSIDE["far"], hidden)) == 0).sum() == 1
    away = Camera(position=(150, 120, 90), focal_point=(300, 240, 180), view_up=(0, 0, 1))
    assert not expected_samples(plan_of(away)).any()
    assert not expected_samples(plan_of(OUTSIDE["far"], np.ones(LAYOUT.counts_zyx, bool))).any()
