from __future__ import annotations

import numpy as np
import pytest

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.memory import ArraySource
from clusterviz.data.source import Grid
from clusterviz.data.summary import VolumeSummary
from clusterviz.errors import InputError
from clusterviz.plan.content import KnownVolume, brick_cost
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.scene.values import Camera, Quality, Scene, Volume

LAYOUT = BrickLayout((11, 6, 21), 5)  # cells 10, 5, 20: bricks 2, 1, 4


def plan_of(
    low: np.ndarray, high: np.ndarray, *, spacing: tuple[float, float, float] = (1, 1, 1), **changes: object
) -> Plan:
    summary = VolumeSummary(low, high, np.ones(4, np.int64), (0.0, 1.0), ())
    volume = Volume(
        path="in memory",
        cmap=((0.0, 0, 0, 0), (1.0, 1, 1, 1)),
        clim=(0.0, 1.0),
        opacity=((0.5, 0.0), (1.0, 0.5)),
        opacity_unit_distance=4.0,
        interpolation=changes.pop("interpolation", "linear"),
    )
    camera = Camera(position=(50, 40, 30), focal_point=(0, 0, 0), view_up=(0, 0, 1))
    scene = Scene(volumes=(volume,), camera=camera, quality=Quality(**changes))
    source = ArraySource(np.zeros(LAYOUT.shape_zyx, np.float32), Grid(LAYOUT.shape_zyx, spacing))
    return make_plan(scene, [KnownVolume(source, LAYOUT, summary)])


def test_cost_is_the_cells_of_a_brick_and_their_sum_those_of_the_volume() -> None:
    layout = BrickLayout((12, 7, 21), 5)  # cells 11, 6, 20: the last bricks along z and y are one cell thick
    cost = brick_cost(layout, np.zeros(layout.counts_zyx, bool))
    assert cost.shape == (3, 2, 4)
    assert cost[0, 0, 0] == 125
    assert cost[2, 1, 3] == 1 * 1 * 5
    assert cost.sum() == 11 * 6 * 20


def test_invisible_bricks_cost_nothing_and_no_visible_one_does() -> None:
    low = np.zeros(LAYOUT.counts_zyx)
    high = np.array([0.2, 0.5, 0.500001, 0.9, 0.1, 0.6, 0.5, -3.0]).reshape(LAYOUT.counts_zyx)
    assert (plan_of(low, high).cost > 0).ravel().tolist() == [False, False, True, True, False, True, False, False]


def test_brick_without_a_valid_sample_costs_nothing() -> None:
    nothing = np.full(LAYOUT.counts_zyx, np.inf)
    assert not plan_of(nothing, -nothing).cost.any()


def test_more_slabs_than_can_be_counted_are_refused() -> None:
    zeros = np.zeros(LAYOUT.counts_zyx)
    with pytest.raises(InputError, match=r"quality\.step: too short for this volume.*at least 2\.1e-08"):
        plan_of(zeros, zeros, spacing=(1e-9,) * 3, step=2e-8)
    assert plan_of(zeros, zeros, spacing=(1e-9,) * 3, step=2.2e-8).march.step_world == pytest.approx(2.2e-17)


def test_single_sample_is_one_brick_of_one_cell() -> None:
    layout = BrickLayout((1, 1, 1), 64)
    assert brick_cost(layout, np.zeros(layout.counts_zyx, bool)).tolist() == [[[1.0]]]


def test_step_is_in_units_of_the_smallest_spacing() -> None:
    zeros = np.zeros(LAYOUT.counts_zyx)
    plan = plan_of(zeros, zeros, spacing=(3, 0.5, 2), step=0.4)
    assert plan.march.step_world == pytest.approx(0.2)
    assert plan.volume.slab_units == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("interpolation", "filter", "expected"),
    [
        ("linear", "exact", "linear"),
        ("linear", "hardware", "hardware"),
        ("nearest", "exact", "nearest"),
        ("nearest", "hardware", "nearest"),
    ],
)
def test_filter_follows_interpolation_and_quality(interpolation: str, filter: str, expected: str) -> None:
    zeros = np.zeros(LAYOUT.counts_zyx)
    assert plan_of(zeros, zeros, interpolation=interpolation, filter=filter).filter == expected


def test_bricks_without_the_margin_that_is_needed_are_refused() -> None:
    nothing = np.zeros(LAYOUT.counts_zyx)
    with pytest.raises(InputError, match="margin"):
        plan_of(nothing, nothing + 1, interpolation="cubic")
