"""Automatic mode: when ranks choose again, which modes the scene allows, and what statistics report."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from auto.scenes import CPU, INSTANT, NODES, OPAQUE, RANKS, SLOW, SOURCE, opened_on, scene_of
from frame.views import check_same, on_ranks, pixels

from clusterviz.auto.mode import PAUSE, AutoMode, compositing_seconds
from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.distribution.contract import Distribution, candidates
from clusterviz.distribution.sort_first import SortFirst
from clusterviz.distribution.static import Coherent, Interleaved
from clusterviz.errors import InputError
from clusterviz.frame import FrameLoop, Rendered
from clusterviz.frame.loop import planned
from clusterviz.plan.accuracy import Picked
from clusterviz.report.decisions import Accuracy


def no_hooks(_: Distribution) -> None:
    """Nothing happens around drawing, which these tests leave out."""


ACCURACY = Accuracy(0.1, 0.0, True, 1.0, "post", "exact", 0.0, "float32", 0, 0, 0.0)


@pytest.mark.cover
@pytest.mark.parametrize(
    ("settings", "accuracy", "share"),
    [({"pixel": "float16"}, None, 2), ({}, ACCURACY, 4), ({}, replace(ACCURACY, error=0.1), 1)],
    ids=["named", "by what is left of a bound", "no bits less, where nothing is left"],
)
def test_the_pixels_of_the_frame_are_those_that_are_weighed(
    settings: dict[str, Any], accuracy: Accuracy | None, share: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = replace(SLOW, seconds_per_byte=1e-3)
    monkeypatch.setattr("clusterviz.auto.mode.default_network", lambda nodes: slow)

    def told(channel: Channel) -> tuple[list[float], list[float]]:
        run, scene, opened, drawing = opened_on(channel, settings)
        plan = opened.plan(scene)
        auto_mode = AutoMode(run, no_hooks, True, scene, True)
        planned(drawing, auto_mode.update(run, scene, plan, accuracy=accuracy))
        found = auto_mode.sharing.forecasts
        floats = [compositing_seconds(plan, NODES, each.groups, slow, "float32") for each in found]
        return floats, [each.seconds_compositing for each in found]

    floats, found = run_loopback(RANKS, told, ranks_per_node=1)[0]
    assert floats == pytest.approx([share * each for each in found], rel=1e-3)


@pytest.mark.cover
@pytest.mark.parametrize(
    ("settings", "several", "shared"),
    [
        (OPAQUE, True, 4),
        (OPAQUE, False, None),
        (OPAQUE | {"compositing": "tree"}, True, None),
        (OPAQUE | {"distribution": "interleaved"}, True, None),
        (OPAQUE | {"mode": "sort-last"}, True, None),
        (OPAQUE | {"memory_limit": 700_000}, True, None),
        ({"opacity": 0.0}, True, None),
        ({"groups": 2}, False, 2),
        ({"mode": "hybrid"}, False, 2),
    ],
    ids=["opaque", "one picture", "algorithm", "distribution", "mode", "memory", "nothing", "groups", "hybrid"],
)
def test_what_the_scene_says_counts(
    settings: dict[str, Any], several: bool, shared: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clusterviz.auto.mode.default_network", lambda nodes: SLOW)

    def chosen(channel: Channel) -> int | None:
        run, scene, opened, drawing = opened_on(channel, settings)
        auto_mode = AutoMode(run, no_hooks, True, scene, several)
        planned(drawing, auto_mode.update(run, scene, opened.plan(scene)))
        if isinstance(auto_mode.distribution, SortFirst):
            assert bool(auto_mode.sharing.forecasts) == (settings == OPAQUE)
            return len(auto_mode.distribution.groups)
        assert type(auto_mode.distribution) is (Interleaved if "distribution" in settings else Coherent)
        return None

    assert run_loopback(RANKS, chosen, ranks_per_node=1) == [shared] * RANKS


def test_ranks_share_no_screen_whose_bricks_have_become_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clusterviz.auto.mode.default_network", lambda nodes: SLOW)

    def chosen(channel: Channel) -> list[type]:
        run, scene, opened, drawing = opened_on(channel, OPAQUE)
        auto_mode, found = AutoMode(run, no_hooks, True, scene, True), []
        for limit in (1 << 40, 700_000):
            auto_mode._budget = replace(auto_mode._budget, limit_bytes=limit)
            planned(drawing, auto_mode.update(run, scene, opened.plan(scene)))
            found.append(type(auto_mode.distribution))
        return found

    assert run_loopback(RANKS, chosen, ranks_per_node=1) == [[SortFirst, Coherent]] * RANKS


def test_a_limit_that_no_way_to_share_keeps_is_refused() -> None:
    with pytest.raises(InputError, match="a brick takes"):
        on_ranks(RANKS, [scene_of({"memory_limit": 5000})], SOURCE, device="cpu")


def test_statistics_tell_what_was_chosen_and_by_what() -> None:
    def job(channel: Channel) -> dict[str, Any]:
        with FrameLoop(scene_of(OPAQUE), channel, SOURCE, CPU) as loop:
            statistics = loop.frame().statistics
            assert f"{statistics.sharing}".count("samples") == len(candidates(RANKS))
            return statistics.as_json()["sharing"]

    told = run_loopback(RANKS, job)
    assert told == [told[0]] * RANKS
    assert [each["groups"] for each in told[0]["forecasts"]] == candidates(RANKS)


MIDDLE = (36.0, 36.0, 36.0)
AFAR = {"position": (300.0, 250.0, 200.0), "focal_point": MIDDLE, "view_angle": 30.0}
INTO_A_CORNER = {"position": (90.0, 88.0, 92.0), "focal_point": (70.0, 70.0, 70.0), "view_angle": 40.0}
FLIGHT = [AFAR] * 3 + [INTO_A_CORNER] * (PAUSE + 1)


def flown(channel: Channel, settings: dict[str, Any], flight: list[dict[str, Any]]) -> list[Rendered]:
    """The frames of a flight, as `animate` draws them."""
    scenes = [scene_of({"size": (80, 60)} | settings | view) for view in flight]
    with FrameLoop(scenes[0], channel, SOURCE, CPU) as loop:
        return list(loop.frames(enumerate(scenes)))


@pytest.fixture(scope="module")
def flight() -> list[list[Rendered]]:
    """What each rank has of a flight from afar to before a corner, where nothing is lost on the way."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("clusterviz.auto.mode.default_network", lambda nodes: INSTANT)
        return run_loopback(RANKS, lambda channel: flown(channel, {}, FLIGHT), ranks_per_node=1)


def test_a_view_that_is_uneven_changes_the_mode(flight: list[list[Rendered]]) -> None:
    """Seen from afar all leaves cost alike; before a corner one of them is all that is seen."""
    modes = [[f"{frame.statistics.sharing}".split(",")[0] for frame in frames] for frames in flight]
    assert modes == [["sort-last"] * PAUSE + ["sort-first"] * 4] * RANKS
    alone = flown(LoopbackChannel(), {}, [AFAR, INTO_A_CORNER])
    for number in (0, PAUSE - 1, PAUSE, len(FLIGHT) - 1):
        expected = alone[int(number >= 3)]
        assert pixels(expected)[..., 3].max() > 0.1
        check_same([flight[0][number]], [expected])


def test_later_choices_rest_on_counts_alone(flight: list[list[Rendered]]) -> None:
    """What a sample takes is measured once: a busy machine cannot change the mode in the middle of a movie."""
    first, then = (flight[0][number].statistics.sharing for number in (0, -1))
    assert first is not None
    assert then is not None
    assert first.forecasts != then.forecasts
    before, after = ([each.seconds_drawing / each.samples for each in way.forecasts] for way in (first, then))
    assert after == pytest.approx(before, rel=1e-6)


@pytest.mark.long
def test_settings_that_hold_a_bound_are_found_before_the_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clusterviz.auto.mode.default_network", lambda nodes: INSTANT)
    # One rank sends nothing, and rounds nothing; several may, within the bound.
    monkeypatch.setattr("clusterviz.auto.error_bound.pick_pixel", lambda *_: Picked("float32"))
    view, bounded = [INTO_A_CORNER], {"max_error": 0.02}
    frame = run_loopback(RANKS, lambda channel: flown(channel, bounded, view), ranks_per_node=1)[0][0]
    (alone,) = flown(LoopbackChannel(), bounded, view)
    assert f"{frame.statistics.sharing}".startswith("sort-first")
    assert frame.statistics.accuracy is not None
    assert alone.statistics.accuracy is not None
    assert frame.statistics.accuracy.step == alone.statistics.accuracy.step
    check_same([frame], [alone])
