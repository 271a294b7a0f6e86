"""Choosing settings for a bound on the error, from pictures whose errors are known."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clusterviz.errors import SceneError
from clusterviz.plan.accuracy import (
    COARSEST,
    FINEST,
    FIRST,
    SAFETY,
    WITNESS,
    Aim,
    Choice,
    choose,
    has_strayed,
    make_aim,
    next_trial,
    verified,
)
from clusterviz.plan.estimate import MOST_TAIL, Trial, largest
from clusterviz.scene import Scene, Volume
from clusterviz.scene.values import Clip, Quality

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
    assert truly >= aim.target / SAFETY / 2 ** (order / 4) / 1.35


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


def followed(aim: Aim, last: Trial, scale: float, coarsest: float = COARSEST) -> tuple[Choice, list[Trial]]:
    """What becomes of a choice in a view whose errors are `scale · step²`."""
    return chosen(aim.following(last, coarsest), {last.classification: (scale, 2.0)})


def test_a_choice_is_followed_by_its_own_way_and_by_as_many_levels_as_the_view_asks_for() -> None:
    aim = Aim(1e-3, PATTERN[..., 0].size, BOTH)
    first, _ = chosen(aim, {"post": (0.02, 2.0), "pre-integrated": (0.06, 2.0)})
    same, trials = followed(aim, first.trial, 0.02)
    level = math.ceil(first.trial.level)
    assert same.trial == first.trial
    assert trials == [Trial("post", one) for one in (level - 2, level - 1, level)]
    harder, trials = followed(aim, first.trial, 0.32)
    assert harder.trial.level == pytest.approx(first.trial.level + 2, abs=0.25)
    assert {trial.classification for trial in trials} == {"post"}
    assert has_strayed(harder, first, aim)


def test_a_step_that_holds_stays_until_a_longer_one_pays_and_is_allowed() -> None:
    aim = Aim(1e-3, PATTERN[..., 0].size, ("post",))
    last = chosen(aim, {"post": (0.02, 2.0)})[0].trial
    assert followed(aim, last, 0.014)[0].trial == last
    assert followed(aim, last, 0.005)[0].trial.level == pytest.approx(last.level - 1, abs=0.25)
    assert followed(aim, last, 0.005, coarsest=last.level)[0].trial == last


def test_where_both_ways_contradict_each_other_neither_is_believed() -> None:
    aim = Aim(1e-3, PATTERN[..., 0].size, BOTH)
    pictures: dict[Trial, NDArray[np.float64]] = {}
    # Midpoints miss something until slabs are an eighth of a voxel long, all alike.
    while (trial := next_trial(pictures, aim)) is not None:
        missing = 0.2 if trial.classification == "post" and trial.level < 3 else 0.0
        pictures[trial] = TRUTH - missing * PATTERN
    assert Trial("post", 3) in pictures
    found = choose(pictures, aim)
    assert found.trial.classification == "pre-integrated" or found.trial.level >= 3


def test_of_few_pixels_only_steps_that_were_drawn_are_taken() -> None:
    few = np.zeros(SHAPE)
    few[:10, :10] = TRUTH[:10, :10]
    aim = Aim(1e-3, PATTERN[..., 0].size, ("post",))
    pictures: dict[Trial, NDArray[np.float64]] = {}
    while (trial := next_trial(pictures, aim)) is not None:
        pictures[trial] = few * (1 + 0.02 * trial.step**2)
    assert choose(pictures, aim).trial in pictures
    assert chosen(aim, {"post": (0.015, 2.0)})[0].trial not in pictures


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


SMOOTH = ((0.0, 0.0), (0.5, 0.1), (0.5, 0.1), (1.0, 0.7))
JUMP = ((0.0, 0.0), (0.5, 0.1), (0.5, 0.7), (1.0, 0.7))
PEAK = ((0.0, 0.0), (0.495, 0.0), (0.5, 0.3), (0.505, 0.0))
"""Of 1 % of the range."""


@pytest.mark.parametrize(
    ("opacity", "more", "jumps", "classifications"),
    [
        (SMOOTH, {}, False, BOTH),
        (JUMP, {}, True, BOTH[1:]),
        (PEAK, {}, True, BOTH[1:]),
        (SMOOTH, {"cmap": ((0.0, 1.0, 0.0, 0.0), (0.5, 1.0, 0.0, 0.0), (0.5, 0.0, 0.0, 1.0))}, True, BOTH[1:]),
        (SMOOTH, {"interpolation": "nearest"}, True, BOTH[:1]),
        (SMOOTH, {"clip": Clip(box=(0.0, 1.0, 0.0, 1.0, 0.0, 1.0))}, True, BOTH),
        (SMOOTH, {"volumes": 2}, True, BOTH),
    ],
)
def test_jumps_and_what_is_nearly_one_are_seen(
    opacity: Any, more: dict[str, Any], jumps: bool, classifications: Any
) -> None:
    settings = {"cmap": "bone", "clim": (0.0, 1.0), "opacity": opacity, "opacity_unit_distance": 1.0} | more
    count, clip = settings.pop("volumes", 1), settings.pop("clip", Clip())
    volume = Volume(path="field:gaussian", **settings)
    aim = make_aim(Scene(volumes=count * (volume,), clip=clip, quality=Quality(max_error=0.01)), 1.0)
    assert aim.jumps == jumps
    assert aim.witness >= WITNESS or not jumps
    assert aim.classifications == classifications
    assert math.isclose(aim.target + aim.residual, 0.01)


@pytest.mark.parametrize("blending", ["maximum", "average"])
def test_the_colour_of_one_scalar_is_refused_where_it_jumps(blending: Any) -> None:
    """However close two samples are, the pixel's scalar may be on either side of the jump."""
    keys = {"cmap": "bone", "clim": (0.0, 1.0), "opacity_unit_distance": 1.0, "blending": blending}
    for opacity in (JUMP, PEAK):
        volume = Volume(path="field:gaussian", opacity=opacity, **keys)
        with pytest.raises(SceneError, match=f"0.01 is out of reach.*{blending}, whose pixels may be on either side"):
            make_aim(Scene(volumes=(volume,), quality=Quality(max_error=0.01)), 1.0)
    smooth = Volume(path="field:gaussian", opacity=SMOOTH, **keys)
    aim = make_aim(Scene(volumes=(smooth,), quality=Quality(max_error=0.01)), 1.0)
    # A ray across a corner of the volume has one sample at all steps longer than its way.
    assert (aim.jumps, aim.witness) == (False, WITNESS)


RED_TO_BLUE = ((0.0, 1.0, 0.0, 0.0), (0.5, 1.0, 0.0, 0.0), (0.5, 0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("more", "change"),
    [
        ({"opacity": JUMP}, math.log(0.9 / 0.3)),
        ({"opacity": JUMP, "opacity_unit_distance": 4.0}, math.log(0.9 / 0.3) / 4),
        ({"opacity": 0.5, "cmap": RED_TO_BLUE}, math.log(2)),
        ({"opacity": PEAK}, 0.0),
        ({"opacity": JUMP, "interpolation": "nearest"}, 0.0),
    ],
)
def test_what_a_ray_may_miss_behind_a_jump_is_bounded(more: dict[str, Any], change: float) -> None:
    """A ray that grazes a surface is behind it for less than a step: no longer step shows how much that is."""
    volume = Volume(path="a.nrrd", **{"cmap": "bone", "clim": (0.0, 1.0), "opacity_unit_distance": 1.0} | more)
    scene = Scene(volumes=(volume,), quality=Quality(max_error=0.1))
    aim = make_aim(scene, 0.5)
    assert math.isclose(aim.jump, change / 2, rel_tol=1e-9, abs_tol=1e-12)
    same = [TRUTH] * 3
    assert math.isclose(verified(same, aim, 4) - aim.residual, 1 - math.exp(-aim.jump / 16), abs_tol=1e-12)


@pytest.mark.parametrize(
    ("top", "bound", "witness"), [(0.05, 0.01, FIRST), (0.1, 0.01, 2), (0.3, 0.01, 3), (0.9, 0.01, WITNESS)]
)
def test_what_changes_slowly_hides_little_between_long_steps(top: float, bound: float, witness: int) -> None:
    """Between two samples a field changes by half a step's share of its range, and shows what is there as long."""
    opacity = ((0.0, 0.0), (1.0, top))
    volume = Volume(path="a.nrrd", cmap="bone", clim=(0.0, 1.0), opacity=opacity, opacity_unit_distance=1.0)
    assert make_aim(Scene(volumes=(volume,), quality=Quality(max_error=bound)), 1.0).witness == witness


def test_a_bound_that_a_ray_can_break_behind_a_jump_is_refused_before_anything_is_drawn() -> None:
    opacity = ((0.0, 0.0), (0.5, 0.0), (0.5, 0.99), (1.0, 0.99))
    volume = Volume(path="a.nrrd", cmap="bone", clim=(0.0, 1.0), opacity=opacity, opacity_unit_distance=0.3)
    with pytest.raises(
        SceneError, match=r"0.0035 is out of reach.*a jump of opacity or colour of a.nrrd.*at least 0.13"
    ):
        make_aim(Scene(volumes=(volume,), quality=Quality(max_error=0.0035)), 1.0)


def test_the_colour_of_one_scalar_is_refused_where_planes_clip() -> None:
    """A ray across a clipped corner may have no sample at all, and so no colour."""
    keys = {"cmap": "bone", "clim": (0.0, 1.0), "opacity_unit_distance": 1.0, "opacity": SMOOTH}
    volume = Volume(path="a.nrrd", blending="average", **keys)
    scene = Scene(volumes=(volume,), clip=Clip(box=(0.0, 1.0, 0.0, 1.0, 0.0, 1.0)), quality=Quality(max_error=0.01))
    with pytest.raises(SceneError, match=r"0.01 is out of reach; found average, of which a ray .*clipped .*no sample"):
        make_aim(scene, 1.0)


def test_the_sample_next_to_an_end_of_a_ray_converges_with_the_step() -> None:
    """It may be the same one at two steps, and half a step away at the next."""
    pictures = [TRUTH.copy() for _ in range(3)]
    for one, off in zip(pictures, (0.1, 0.04, 0.04), strict=True):
        one[7, 9, 1] += off
    aim = Aim(0.05, PATTERN[..., 0].size, ("post",), of_one_scalar=True)
    assert verified(pictures, aim, 5) - aim.residual == pytest.approx(2 * 0.06 / 4)
    assert verified(pictures, replace(aim, of_one_scalar=False), 5) - aim.residual == pytest.approx(2 * 0.06 / 12)


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_a_single_pixel_is_verified(order: float) -> None:
    """However few pixels are wrong: the estimate of all of them is no smaller than the error."""
    pictures = [TRUTH.copy() for _ in range(3)]
    for level, one in enumerate(pictures):
        one[7, 9, 1] += 0.1 * 2.0 ** (-order * level)
    aim = Aim(0.05, PATTERN[..., 0].size, ("post",), jumps=True)
    error = 0.1 * 4.0**-order
    assert error <= verified(pictures, aim, 2) - aim.residual <= 2.001 * (2**order - 1) * error


def test_a_narrow_peak_that_does_not_converge_like_the_other_pixels_is_verified() -> None:
    """The largest changes fall by 4, but those of one pixel, whose peak the longer steps missed, do not."""
    pictures = [TRUTH.copy() for _ in range(3)]
    for one, smooth, peak in zip(pictures, (0.0363, 0.0091, 0.0023), (0.0155, 0.0155, 0.0087), strict=True):
        one[7, 9, 1] += smooth
        one[3, 4, 1] += peak
    aim = Aim(2 / 255, PATTERN[..., 0].size, ("post",), jumps=True)
    assert verified(pictures, aim, 2) > aim.bound


def test_what_only_some_pixels_miss_is_verified_without_jumps_too() -> None:
    """Smooth pixels promise a third of their last change; one that converges late, all of it; a long step, its own."""
    smooth = [np.zeros(SHAPE) + 0.016 * 4.0**-level for level in range(3)]
    aim = Aim(0.05, PATTERN[..., 0].size, ("post",))
    assert verified(smooth, aim, 2) - aim.residual == pytest.approx(2 * 0.001)
    late = [one.copy() for one in smooth]
    late[2][7, 9, 1] += 0.01
    assert 2 * 0.005 < verified(late, aim, 2) - aim.residual <= 2 * 0.01
    assert verified(smooth, aim, 2, coarser=2) - aim.residual == pytest.approx(2 * 0.001 + 0.015)
