"""Pareto front and verdict of quality settings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clusterviz.report.pages.tradeoff.ground_truth import GroundTruth, Halving
from clusterviz.report.pages.tradeoff.knobs import Setting
from clusterviz.report.pages.tradeoff.measure import Cost
from clusterviz.report.pages.tradeoff.rating import (
    RatedSetting,
    fastest_within,
    pareto_front,
    rate,
    verdict,
    with_front_numbers,
)

LEVEL = 1 / 255
TRUTH = GroundTruth(np.full((12, 12, 4), 0.5), "reference", "", 0.1, 1e-5, 1e-6, (Halving(0.1, 1e-5, 1e-6),))
COST = Cost(0.01, 0.1, 0.1, 0.1, 1000, 1 << 20, 1 << 28, 0, 0)


def setting(seconds: float, error: float, **changes: Any) -> RatedSetting:
    kind = "alone" if changes else "scene"
    cost = replace(COST, total_seconds=seconds, total_seconds_min=seconds, total_seconds_max=seconds)
    return RatedSetting(Setting(changes, kind), cost, error, error / 10, 0, 1.0, np.zeros((1, 1, 4), np.float32))


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1))
def test_the_front_is_what_nothing_beats(points: list[tuple[int, int]]) -> None:
    front = pareto_front(points)
    best = {point for point, on in zip(points, front, strict=True) if on}
    for point, on in zip(points, front, strict=True):
        beaten = any(other != point and other[0] <= point[0] and other[1] <= point[1] for other in points)
        assert on != beaten
    assert best
    assert len({x for x, _ in best}) == len(best)  # of one time only one error


def test_the_front_is_numbered_from_the_fastest_on() -> None:
    rated = [
        setting(0.2, 0.01),
        setting(0.1, 0.1, step=2.0),
        setting(0.3, 0.01, brick=32),
        setting(0.4, 0.001, step=0.5),
    ]
    assert [one.front for one in with_front_numbers(rated, TRUTH)] == [2, 1, 0, 3]


def test_what_is_below_the_truths_own_error_is_no_better() -> None:
    rated = [setting(0.2, 5e-6), setting(0.3, 1e-9, step=0.5), setting(0.4, 1.0, step=4.0)]
    assert [one.front for one in with_front_numbers(rated, TRUTH)] == [1, 0, 0]


def test_errors_are_those_of_the_picture() -> None:
    image = np.full((12, 12, 4), 0.5, np.float32)
    image[3, 4, 1] += 0.25
    rated = rate(Setting({}, "scene"), COST, image, TRUTH, (0.0, 0.0, 0.0))
    assert (rated.max, rated.wrong_pixels) == (0.25, 1)
    assert rated.rms == pytest.approx(0.25 / np.sqrt(12 * 12 * 4))
    assert 0.5 < rated.ssim < 1
    exact = rate(Setting({}, "scene"), COST, TRUTH.picture.astype(np.float32), TRUTH, None)
    assert (exact.max, exact.wrong_pixels, exact.ssim) == (0, 0, pytest.approx(1))


def test_the_fastest_within_a_bound() -> None:
    rated = [setting(0.2, 0.01), setting(0.1, 0.1, step=2.0), setting(0.15, 0.01, brick=32)]
    assert fastest_within(rated, 0.05, TRUTH) is rated[2]
    assert fastest_within(rated, 1e-3, TRUTH) is None


def test_the_verdict_names_what_is_faster_at_no_larger_error() -> None:
    rated = [setting(0.2, 4 * LEVEL), setting(0.05, 4 * LEVEL, early_termination=0.01), setting(0.4, LEVEL, step=0.5)]
    text = " ".join(verdict(rated, TRUTH))
    assert "takes 200 ms and errs by up to 4.1 levels of 255" in text
    assert "With early_termination 0.01 it is 4 times faster at no larger error." in text
    assert "within 2 levels of 8 bits is step 0.5: 400 ms" in text


def test_the_verdict_where_the_scene_is_best_and_nothing_is_exact() -> None:
    text = " ".join(verdict([setting(0.1, 8 * LEVEL), setting(0.2, 4 * LEVEL, step=0.5)], TRUTH))
    assert "No setting that was tried is faster at no larger error." in text
    assert (
        "None comes within 2 levels of 8 bits; step 0.5 comes closest, with up to 4.1 levels of 255, and takes 200 ms"
        in text
    )


def test_noise_is_no_gain() -> None:
    scene = setting(0.2, 0.1)
    noisy = replace(scene, cost=replace(scene.cost, total_seconds_min=0.1))
    text = " ".join(verdict([noisy, setting(0.15, 0.1, brick=32)], TRUTH))
    assert "No setting that was tried is faster" in text


def test_a_busy_machine_is_told_and_smaller_gains_are_not() -> None:
    rated = [setting(0.2, 0.1), setting(0.12, 0.1, brick=32)]
    assert "1.7 times faster" in " ".join(verdict(rated, TRUTH, 1.1))
    busy = " ".join(verdict(rated, TRUTH, 1.8))
    assert "No setting that was tried is faster" in busy
    assert "took 1.8 times as long" in busy


def test_an_error_is_claimed_with_the_truths_own_and_rounded_up() -> None:
    assert "errs by up to 1.1e-05 of full scale." in verdict([setting(0.1, 1e-9)], TRUTH)[0]
    assert "errs by up to 4.2 levels of 255." in verdict([setting(0.1, 4.101 * LEVEL)], TRUTH)[0]


@pytest.mark.parametrize("known", [True, False])
def test_a_setting_with_a_larger_error_is_not_called_as_exact_however_little_the_truth_is_known(known: bool) -> None:
    truth = TRUTH if known else replace(TRUTH, max=0.7, rms=0.2)
    rated = [setting(0.2, 0.19), setting(0.1, 0.89, step=4.0)]
    assert "No setting that was tried is faster at no larger error." in verdict(rated, truth)


def test_where_single_pixels_are_not_known_rms_errors_judge() -> None:
    """`setting` has a tenth of its largest error as rms."""
    truth = replace(TRUTH, max=0.6, rms=1e-3)
    rated = [setting(0.2, 0.5), setting(0.1, 0.05, step=0.5), setting(0.05, 0.7, step=4.0)]
    assert [one.front for one in with_front_numbers(rated, TRUTH)] == [0, 2, 1]
    assert [one.front for one in with_front_numbers(rated, truth)] == [0, 2, 1]
    assert [one.front for one in with_front_numbers(rated, replace(truth, rms=0.1))] == [0, 0, 1]
    text = " ".join(verdict(rated, truth))
    assert "errs by up to 14 levels of 255, rms" in text
    assert "not known well enough to judge by" in text
    assert "With step 0.5 it is 2 times faster at no larger error." in text
