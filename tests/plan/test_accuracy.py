"""Choosing settings for a bound on the error, from pictures whose errors are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from clusterviz.plan.accuracy import (
    COARSEST,
    FINEST,
    MOST_TAIL,
    Aim,
    Choice,
    Trial,
    choose,
    largest,
    make_aim,
    next_trial,
)
from clusterviz.scene import Scene, Volume
from clusterviz.scene.values import Quality

RNG = np.random.default_rng(7)
SHAPE = (40, 40, 4)
TRUTH = RNG.random(SHAPE)
PATTERN = RNG.random(SHAPE)
BOTH = ("post", "pre-integrated")


def picture(trial: Trial, orders: dict[str, tuple[float, float]]) -> NDArray[np.float64]:
    """The truth with an error of `scale · step^order`, by the way of classification."""
    scale, order = orders[trial.classification]
    return TRUTH + scale * trial.step**order * PATTERN


def chosen(aim: Aim, orders: dict[str, tuple[float, float]]) -> tuple[Choice, list[Trial]]:
    pictures: dict[Trial, NDArray[np.float64]] = {}
    while (trial := next_trial(pictures, aim)) is not None:
        assert trial not in pictures
        pictures[trial] = picture(trial, orders)
    return choose(pictures, aim), list(pictures)


@pytest.mark.parametrize("order", [1.0, 2.0])
@pytest.mark.parametrize("bound", [2 / 255, 1 / 255, 1e-3])
@pytest.mark.parametrize("jumps", [False, True])
def test_the_step_holds_the_bound_and_is_not_much_shorter_than_needed(order: float, bound: float, jumps: bool) -> None:
    aim = Aim(bound, PATTERN[..., 0].size, ("post",), jumps)
    found, _ = chosen(aim, {"post": (0.01, order)})
    truly = 0.01 * found.trial.step**order
    assert truly <= found.error - aim.residual <= aim.target
    # The safety, a quarter of a level, and nothing else.
    assert truly >= aim.target / aim.safety / 2 ** (order / 4) / 1.35


def test_the_way_that_is_cheaper_is_taken_and_the_other_is_left_alone() -> None:
    aim = Aim(1e-3, PATTERN[..., 0].size, BOTH)
    steep, trials = chosen(aim, {"post": (2.0, 2.0), "pre-integrated": (0.02, 2.0)})
    assert steep.trial.classification == "pre-integrated"
    assert max(trial.level for trial in trials if trial.classification == "post") < steep.trial.level
    smooth, _ = chosen(aim, {"post": (0.02, 2.0), "pre-integrated": (0.06, 2.0)})
    assert smooth.trial.classification == "post"


def test_a_bound_that_no_step_holds_gets_the_finest_and_says_so() -> None:
    aim = Aim(1e-4, PATTERN[..., 0].size, ("post",))
    found, trials = chosen(aim, {"post": (0.5, 0.5)})
    assert found.trial.level == max(trial.level for trial in trials) == FINEST
    assert found.error > aim.bound


def test_an_empty_picture_needs_no_fine_step() -> None:
    aim = Aim(1e-3, PATTERN[..., 0].size, BOTH)
    found, trials = chosen(aim, {"post": (0.0, 1.0), "pre-integrated": (0.0, 1.0)})
    assert found.trial == Trial("post", COARSEST)
    assert found.error == pytest.approx(aim.residual)
    assert len(trials) == 6


def test_of_all_pixels_the_largest_is_known_and_of_some_it_is_extrapolated() -> None:
    errors = RNG.random(1000)
    assert largest(errors, 1000) == errors.max()
    tail = RNG.pareto(3.0, 64000) + 1.0
    estimates = [largest(tail[start::64], tail.size) / tail.max() for start in range(64)]
    assert 0.7 < np.median(estimates) < 1.6
    assert largest(np.geomspace(1e-9, 1.0, 100), 10**9) == MOST_TAIL
    assert largest(np.zeros(100), 10**6) == 0.0


def test_jumps_of_the_opacity_are_seen_and_steps_of_the_colour_are_not() -> None:
    def aim(opacity: tuple[tuple[float, float], ...]) -> Aim:
        volume = Volume(path="field:gaussian", cmap="bone", clim=(0.0, 1.0), opacity=opacity, opacity_unit_distance=1.0)
        return make_aim(Scene(volumes=(volume,), quality=Quality(max_error=0.01)))

    assert aim(((0.0, 0.0), (0.5, 0.1), (0.5, 0.7), (1.0, 0.7))).jumps
    smooth = aim(((0.0, 0.0), (0.5, 0.1), (0.5, 0.1), (1.0, 0.7)))
    assert not smooth.jumps
    assert smooth.ways == BOTH
    assert math.isclose(smooth.target + smooth.residual, 0.01)
