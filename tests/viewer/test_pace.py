"""The choice of size and quality of moving pictures, on simulated machines."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from clusterviz.scene import scene_of_data
from clusterviz.viewer.pace import DRAWING_SHARE, LEVELS, Pace

PIXELS = 800 * 600
BUDGET = 0.05


def drive(pace: Pace, fixed: float, per_pixel: float, frames: int, noise: float = 0.0) -> list[tuple[int, float]]:
    """Level and seconds of frames on a machine with a fixed cost and a cost of each pixel at full quality."""
    rng, found = np.random.default_rng(3), []
    for _ in range(frames):
        level = pace.level
        seconds = fixed + LEVELS[level].cost * PIXELS * per_pixel * (1 + noise * rng.uniform(-1, 1))
        pace.learn(PIXELS, seconds, fixed)
        found.append((level, seconds))
    return found


def test_each_level_costs_less_than_the_one_before() -> None:
    assert all(fine.cost >= coarse.cost for fine, coarse in pairwise(LEVELS))
    assert all(fine.early_termination <= coarse.early_termination for fine, coarse in pairwise(LEVELS))


@pytest.mark.parametrize("per_pixel", [1e-9, 3e-8, 3e-7, 1e-6])
@pytest.mark.parametrize("fixed", [1e-3, 0.012])
def test_frames_keep_the_budget_with_the_finest_level_that_fits(fixed: float, per_pixel: float) -> None:
    found = drive(Pace(BUDGET), fixed, per_pixel, 40, noise=0.1)[10:]
    levels = {level for level, _ in found}
    assert len(levels) == 1, "no alternation"
    assert all(seconds <= BUDGET for _, seconds in found)
    finer = levels.pop() - 1
    assert finer < 0 or fixed + 1.1 * LEVELS[finer].cost * PIXELS * per_pixel > 0.8 * DRAWING_SHARE * BUDGET


def test_a_single_slow_frame_changes_nothing() -> None:
    pace = Pace(BUDGET)
    drive(pace, 0.005, 1e-7, 20)
    level = pace.level
    pace.learn(PIXELS, 2.0, 0.005)
    assert pace.level == level


def test_a_machine_that_is_too_slow_gets_the_coarsest_level() -> None:
    assert drive(Pace(BUDGET), 0.04, 1e-4, 10)[-1][0] == len(LEVELS) - 1


def test_a_change_of_the_cost_is_learnt_within_some_frames() -> None:
    pace = Pace(BUDGET)
    drive(pace, 0.005, 1e-8, 20)
    assert pace.level == 0
    slower = drive(pace, 0.005, 1e-6, 10)
    assert [seconds <= BUDGET for _, seconds in slower].index(True) <= 3
    faster = drive(pace, 0.005, 1e-8, 10)
    assert faster[-1][0] == 0


def test_settings_change_size_step_and_the_end_of_rays_only() -> None:
    scene = scene_of_data("a.npy", ["image.size=[801, 600]", "image.layers=[depth]", "quality.max_error=0.1"])
    pace = Pace(BUDGET)
    level = LEVELS[pace.level]
    moving = pace.settings(scene)
    assert moving.image.size == (round(801 * level.scale), round(600 * level.scale))
    assert moving.image.layers == ()
    assert moving.quality.step == level.step
    assert (moving.quality.early_termination, moving.quality.max_error) == (level.early_termination, None)
    assert moving.model_copy(update={"image": scene.image, "quality": scene.quality}) == scene
