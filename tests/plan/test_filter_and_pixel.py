"""What is taken beside the step under a bound, and what is said of it."""

from __future__ import annotations

import pytest

from clusterviz.plan.accuracy import Aim, Choice, Picked, Probe, pick_filter, pick_pixel, reduced, why_exact
from clusterviz.plan.estimate import Trial

AIM = Aim(0.01, 10_000, ("post",))
EXACT = Choice(Trial("post", 2.0), 0.009)
BOUNDS = {"uint8": 0.02, "float16": 0.002}


@pytest.mark.parametrize(
    ("probe", "level", "picked", "said"),
    [
        (Probe(0.001, 0.4), 2.0, "hardware", "adds about 0.001 and takes 0.40 of the time a sample"),
        (Probe(0.001, 0.4), 3.0, "hardware", "takes 0.40"),
        (Probe(0.001, 0.4), 3.5, "exact", "no gain with the step that it asks for"),
        (Probe(0.001, 1.3), 2.0, "exact", "takes 1.30 of the time a sample: no gain"),
        (Probe(0.004, 0.4), 2.0, "exact", "adds about 0.004, which the step cannot make up for"),
        (Probe(0.004, None), 2.0, "exact", "adds about 0.004, which the step cannot make up for"),
    ],
)
def test_the_texture_unit_must_hold_the_bound_and_pay(probe: Probe, level: float, picked: str, said: str) -> None:
    instead = Choice(Trial("post", level), 0.008)
    filter, choice = pick_filter(probe, EXACT, instead, AIM)
    assert filter.value == picked
    assert said in filter.reason
    if picked == "hardware":
        assert choice == Choice(instead.trial, 0.008 + probe.error)
        assert choice.error <= AIM.bound
    else:
        assert (choice, filter.error) == (EXACT, 0.0)


def test_what_the_texture_unit_leaves_is_for_the_step_or_it_is_too_little() -> None:
    less = reduced(AIM, 0.004)
    assert less is not None
    assert less.bound == pytest.approx(0.006)
    assert reduced(AIM, 0.006) is None
    assert pick_filter(Probe(0.006, None), EXACT, None, AIM)[0].value == "exact"


def test_the_texture_unit_is_not_tried_where_there_is_none() -> None:
    assert why_exact("linear", 1, True) == ""
    assert "no texture unit" in why_exact("linear", 1, False)
    assert "several volumes" in why_exact("linear", 2, True)
    assert "nearest" in why_exact("nearest", 1, True)


def test_pixels_have_the_fewest_bits_for_which_there_is_room() -> None:
    assert pick_pixel(BOUNDS, 0.03, 4, True).value == "uint8"
    assert pick_pixel(BOUNDS, 0.003, 4, True) == Picked(
        "float16", 0.002, "adds 0.002 at most, where 0.003 of the bound is left"
    )
    assert "float16 may add 0.002, and 0.001" in pick_pixel(BOUNDS, 0.001, 4, True).reason
    assert "and 0 of the bound" in pick_pixel(BOUNDS, -0.1, 4, True).reason
    assert pick_pixel(BOUNDS, 0.03, 1, True) == Picked("float32", 0.0, "one rank sends nothing")
    assert pick_pixel(BOUNDS, 0.03, 4, False).value == "float32"
