"""What mode: auto chooses, and by what: samples of each rank that a pre-pass foresees."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import Channel, LoopbackChannel, run_loopback
from clusterviz.composite.model.network import default_network
from clusterviz.data.memory import ArraySource
from clusterviz.errors import InputError
from clusterviz.frame import FrameLoop, Options, Rendered, Run
from clusterviz.frame.choosing import PAUSE, Choosing
from clusterviz.frame.coherent import Coherent
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.holding import Holding
from clusterviz.frame.mode import candidates, choose, compositing_seconds, forecast, held_bytes
from clusterviz.frame.opening import open_volumes
from clusterviz.frame.prepass import LOOKS, sound
from clusterviz.frame.share import Share
from clusterviz.frame.shared_screen import SharedScreen
from clusterviz.frame.sounding import Sounding, drawing_seconds, samples_of_ranks
from clusterviz.image import PartialImage, compare
from clusterviz.partition.screen import rank_groups
from clusterviz.plan.leftover import Picked
from clusterviz.plan.plan import Plan
from clusterviz.report.accuracy import Accuracy
from clusterviz.report.sharing import Forecast
from clusterviz.report.statistics import RankFrame
from clusterviz.scene import Scene, Volume
from clusterviz.scene.complete import complete_scene
from clusterviz.scene.settings import with_settings

RANKS = 4
NODES = tuple((rank,) for rank in range(RANKS))
SLOW = replace(default_network(RANKS), seconds_per_byte=1e-6)
INSTANT = replace(default_network(RANKS), seconds_per_byte=0.0, message_seconds=0.0, frame_seconds=0.0)
OPAQUE = {"opacity": 1.0, "opacity_unit_distance": 60.0, "early_termination": 1 / 255}
SOURCE = ArraySource(np.random.default_rng(1).random((73, 73, 73), np.float32))
CPU = Options(device="cpu")


def scene_of(settings: dict[str, Any]) -> Scene:
    settings = {"size": (160, 120), "brick": 12, "clim": (0.0, 1.0), "opacity": 0.1} | settings
    return with_settings(Scene(volumes=(Volume(path="array"),)), settings)


def sounding_of(settings: dict[str, Any]) -> tuple[Plan, Sounding]:
    """What a pre-pass finds."""

    def job(channel: Channel) -> tuple[Plan, Sounding | None]:
        run = Run(channel, CPU)
        opened = open_volumes(run, scene_of(settings), SOURCE)
        assert opened is not None
        scene = complete_scene(scene_of(settings), opened.facts)
        return opened.plan(scene), sound(run, Drawing(run), opened, scene, opened.plan(scene))

    told = run_loopback(RANKS, job)
    assert [sounding is None for _, sounding in told] == [False, True, True, True]
    plan, sounding = told[0]
    assert sounding is not None
    assert sounding.seconds_per_sample > 0
    assert sounding.crowd >= 1
    return plan, sounding


def sounded(settings: dict[str, Any]) -> tuple[Plan, Sounding]:
    """What a pre-pass finds, at a nanosecond a sample and a core a rank."""
    plan, sounding = sounding_of(settings)
    return plan, replace(sounding, seconds_per_sample=1e-9, crowd=1.0)


@pytest.fixture(scope="module")
def opaque() -> tuple[Plan, Sounding]:
    return sounded(OPAQUE)


@pytest.fixture(scope="module")
def clear() -> tuple[Plan, Sounding]:
    return sounded({})


def drawn(settings: dict[str, Any]) -> list[int]:
    """What ranks really take."""

    def job(channel: Channel) -> list[int]:
        with FrameLoop(scene_of(settings), channel, SOURCE, CPU) as loop:
            return [rank.samples - rank.samples_estimate for rank in loop.frame().statistics.per_rank]

    return run_loopback(RANKS, job)[0]


def test_samples_of_ranks_are_foreseen(opaque: tuple[Plan, Sounding]) -> None:
    """By early ends of rays, too: in sort-last each rank's own, in sort-first all that lies in front."""
    plan, sounding = opaque
    last, both, first = (samples_of_ranks(sounding, plan, rank_groups(RANKS, groups)) for groups in (1, 2, RANKS))
    assert last == pytest.approx(drawn(OPAQUE | {"mode": "sort-last"}), rel=0.12)
    assert first.sum() == pytest.approx(sum(drawn(OPAQUE | {"mode": "sort-first"})), rel=0.12)
    found = drawn(OPAQUE | {"mode": "hybrid", "groups": 2, "tiling": "estimated"})
    assert both.sum() == pytest.approx(sum(found), rel=0.12)
    assert both.max() == pytest.approx(max(found), rel=0.2)
    assert last.sum() > 1.4 * first.sum()


def test_what_is_opaque_asks_for_the_screen_to_be_shared(opaque: tuple[Plan, Sounding]) -> None:
    plan, sounding = opaque
    found = [forecast(plan, Holding(), NODES, groups, INSTANT, sounding) for groups in (1, 2, RANKS)]
    assert found[0].samples > 1.2 * found[2].samples
    assert choose(found) == RANKS


def test_what_is_clear_and_even_stays_sort_last(clear: tuple[Plan, Sounding]) -> None:
    """Whoever draws it, the samples are the same, and sharing the screen then gains little."""
    plan, sounding = clear
    found = [forecast(plan, Holding(), NODES, groups, INSTANT, sounding) for groups in candidates(RANKS)]
    total = [samples_of_ranks(sounding, plan, rank_groups(RANKS, each.groups)).sum() for each in found]
    assert total == pytest.approx([total[0]] * len(total), rel=1e-3)
    few = [replace(each, seconds_compositing=0.0, seconds_drawing=each.samples) for each in found]
    assert few[-1].seconds < few[0].seconds
    assert choose([replace(few[0], seconds_drawing=few[-1].seconds * 1.1), *few[1:]]) == 1


def test_slow_links_ask_for_pixels_that_travel_once(clear: tuple[Plan, Sounding]) -> None:
    plan, sounding = clear
    assert choose([forecast(plan, Holding(), NODES, groups, SLOW, sounding) for groups in candidates(RANKS)]) == RANKS


@pytest.mark.parametrize("groups", [1, 2, RANKS])
def test_pixels_of_fewer_bits_take_less_to_join(clear: tuple[Plan, Sounding], groups: int) -> None:
    plan, sounding = clear
    slow = replace(SLOW, seconds_per_byte=1e-3)
    full, half, quarter = (
        forecast(plan, Holding(), NODES, groups, slow, sounding, pixel).seconds_compositing
        for pixel in ("float32", "float16", "uint8")
    )
    assert full == pytest.approx(2 * half, rel=1e-3)
    assert full == pytest.approx(4 * quarter, rel=1e-3)


ACCURACY = Accuracy(0.1, 0.0, True, 1.0, "post", "exact", 0.0, "float32", 0, 0, 0.0)


@pytest.mark.parametrize(
    ("settings", "accuracy", "share"),
    [({"pixel": "float16"}, None, 2), ({}, ACCURACY, 4), ({}, replace(ACCURACY, error=0.1), 1)],
    ids=["named", "by what is left of a bound", "no bits less, where nothing is left"],
)
def test_the_pixels_of_the_frame_are_those_that_are_weighed(
    settings: dict[str, Any], accuracy: Accuracy | None, share: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = replace(SLOW, seconds_per_byte=1e-3)
    monkeypatch.setattr("clusterviz.frame.choosing.default_network", lambda nodes: slow)

    def told(channel: Channel) -> tuple[list[float], list[float]]:
        run = Run(channel, CPU)
        opened = open_volumes(run, scene_of(settings), SOURCE)
        assert opened is not None
        scene = complete_scene(scene_of(settings), opened.facts)
        choosing = Choosing(run, Drawing(run), opened, scene, True)
        choosing.look(scene, accuracy=accuracy)
        found, plan = choosing.sharing.forecasts, opened.plan(scene)
        floats = [compositing_seconds(plan, NODES, each.groups, slow, "float32") for each in found]
        return floats, [each.seconds_compositing for each in found]

    floats, found = run_loopback(RANKS, told, ranks_per_node=1)[0]
    assert floats == pytest.approx([share * each for each in found], rel=1e-3)


def test_dear_samples_and_dear_links_weigh_against_each_other(opaque: tuple[Plan, Sounding]) -> None:
    """The time of a sample is that of the device: where it is short, compositing decides."""
    plan, sounding = opaque
    quick, slow = (
        forecast(plan, Holding(), NODES, 1, SLOW, replace(sounding, seconds_per_sample=each)) for each in (1e-12, 1e-4)
    )
    assert quick.seconds_compositing == slow.seconds_compositing > quick.seconds_drawing
    assert slow.seconds_drawing > slow.seconds_compositing
    assert slow.seconds_drawing == pytest.approx(1e-4 * slow.samples)


def test_ranks_that_share_cores_wait_for_all_of_them(clear: tuple[Plan, Sounding]) -> None:
    """Uneven samples cost nothing as long as every core has something to do."""
    samples, crowded = np.array([1.0, 3.0, 2.0, 2.0]), replace(clear[1], seconds_per_sample=4.0, crowd=4.0)
    assert drawing_seconds(replace(crowded, crowd=1.0), samples, NODES) == 12
    assert drawing_seconds(crowded, samples, ((0, 1, 2, 3),)) == 8
    assert drawing_seconds(crowded, samples, ((0, 2), (1, 3))) == 10


def test_more_groups_hold_more(clear: tuple[Plan, Sounding]) -> None:
    held = [held_bytes(clear[0], Holding(), RANKS, groups) for groups in candidates(RANKS)]
    assert held == sorted(held)
    assert held[-1] > 2 * held[0]


@pytest.mark.parametrize("ranks", [1, 2, 3, 5, 7, 8, 64, 1000])
def test_numbers_of_groups_that_are_compared(ranks: int) -> None:
    found = candidates(ranks)
    assert found == sorted(set(found))
    assert (found[0], found[-1]) == (1, ranks)
    assert len(found) <= 40
    assert ranks != 3 or 2 in found


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
    monkeypatch.setattr("clusterviz.frame.choosing.default_network", lambda nodes: SLOW)

    def chosen(channel: Channel) -> int | None:
        run = Run(channel, CPU)
        opened = open_volumes(run, scene_of(settings), SOURCE)
        assert opened is not None
        scene = complete_scene(scene_of(settings), opened.facts)
        choosing = Choosing(run, Drawing(run), opened, scene, several)
        choosing.look(scene)
        if isinstance(choosing.distribution, SharedScreen):
            assert bool(choosing.sharing.forecasts) == (settings == OPAQUE)
            return len(choosing.distribution.groups)
        assert isinstance(choosing.distribution, Coherent) or "distribution" in settings
        return None

    assert run_loopback(RANKS, chosen, ranks_per_node=1) == [shared] * RANKS


def test_a_limit_that_no_way_to_share_keeps_is_refused() -> None:
    def job(channel: Channel) -> None:
        with FrameLoop(scene_of({"memory_limit": 5000}), channel, SOURCE, CPU) as loop:
            loop.frame()

    with pytest.raises(InputError, match="largest share of 4 ranks"):
        run_loopback(RANKS, job)


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
        patched.setattr("clusterviz.frame.choosing.default_network", lambda nodes: INSTANT)
        return run_loopback(RANKS, lambda channel: flown(channel, {}, FLIGHT), ranks_per_node=1)


def test_a_view_that_is_uneven_changes_the_mode(flight: list[list[Rendered]]) -> None:
    """Seen from afar all leaves cost alike; before a corner one of them is all that is seen."""
    modes = [[f"{frame.statistics.sharing}".split(",")[0] for frame in frames] for frames in flight]
    assert modes == [["sort-last"] * PAUSE + ["sort-first"] * 4] * RANKS
    alone = flown(LoopbackChannel(), {}, [AFAR, INTO_A_CORNER])
    for number in (0, PAUSE - 1, PAUSE, len(FLIGHT) - 1):
        found, expected = flight[0][number].image, alone[int(number >= 3)].image
        assert found is not None
        assert expected is not None
        assert expected[..., 3].max() > 0.1
        assert compare(found, expected, 1e-5).count == 0


def test_later_choices_rest_on_counts_alone(flight: list[list[Rendered]]) -> None:
    """What a sample takes is measured once: a busy machine cannot change the mode in the middle of a movie."""
    first, then = (flight[0][number].statistics.sharing for number in (0, -1))
    assert first is not None
    assert then is not None
    assert first.forecasts != then.forecasts
    before, after = ([each.seconds_drawing / each.samples for each in way.forecasts] for way in (first, then))
    assert after == pytest.approx(before, rel=1e-6)


def test_what_is_there_is_given_up_only_for_what_is_clearly_better() -> None:
    last, shared = Forecast(1, 1.0, 1.0, 0.0, 0), Forecast(4, 1.0, 0.85, 0.0, 0)
    assert choose([last, shared]) == 4
    assert choose([last, shared], present=1) == 1
    assert choose([last, shared], present=4) == 4
    assert choose([replace(last, seconds_drawing=0.7), shared], present=4) == 4
    assert choose([replace(last, seconds_drawing=0.67), shared], present=4) == 1
    assert choose([last, shared], present=2) == 4  # which no longer fits


def test_of_ways_that_take_nearly_as_long_the_one_that_holds_least_is_chosen() -> None:
    """Not by the last digit of what a sample was measured to take; but each has to win clearly."""
    ways = [Forecast(groups, 1.0, seconds, 0.0, 0) for groups, seconds in ((1, 1.0), (2, 0.72), (3, 0.75), (4, 0.7))]
    assert choose(ways) == 2
    assert choose(ways[::-1]) == 2
    assert choose([replace(each, seconds_drawing=each.seconds + 0.19 * (each.groups > 1)) for each in ways]) == 4
    assert choose([*ways[:1], replace(ways[1], seconds_drawing=0.75), *ways[2:]]) == 4
    # What comes from counts is the same in every run.
    assert choose([replace(each, seconds_drawing=0.0, seconds_compositing=each.seconds) for each in ways]) == 4
    assert choose(ways[1:], present=1) == 2  # which no longer fits


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_look_that_others_held_up_is_not_believed(late: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what a sample takes, the shortest time is what the device takes for it."""
    draw, drawn = Drawing.draw, [0] * RANKS

    def held_up(self: Drawing, share: Share) -> tuple[list[PartialImage], RankFrame]:
        found, run = draw(self, share), self._run
        drawn[run.channel.rank] += 1
        if drawn[run.channel.rank] == 2 + late:  # the first is the coarse picture
            run.clock.add("render", 1e4)
        return found

    monkeypatch.setattr(Drawing, "draw", held_up)
    _, sounding = sounding_of({})
    assert drawn == [1 + LOOKS] * RANKS
    assert 0 < sounding.seconds_per_sample < 1e-3


@pytest.mark.parametrize("seconds", [1e-12, 1e-9, 1e-6, 1e-3])
def test_what_is_better_in_both_is_chosen_whatever_a_sample_takes(seconds: float) -> None:
    """A busy machine measures longer samples, and begins with the same mode unless samples stand against messages."""

    def way(groups: int, samples: float, compositing: float) -> Forecast:
        return Forecast(groups, samples, seconds * samples, compositing, 0)

    assert choose([way(1, 1e5, 1e-3), way(4, 0.89e5, 0.89e-3)]) == 4
    assert choose([way(1, 1e5, 1e-3), way(4, 0.91e5, 0.91e-3)]) == 1


def test_settings_that_hold_a_bound_are_found_before_the_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clusterviz.frame.choosing.default_network", lambda nodes: INSTANT)
    # One rank sends nothing, and rounds nothing; several may, within the bound.
    monkeypatch.setattr("clusterviz.frame.settling.pick_pixel", lambda *_: Picked("float32"))
    view, bounded = [INTO_A_CORNER], {"max_error": 0.02}
    frame = run_loopback(RANKS, lambda channel: flown(channel, bounded, view), ranks_per_node=1)[0][0]
    (alone,) = flown(LoopbackChannel(), bounded, view)
    assert f"{frame.statistics.sharing}".startswith("sort-first")
    assert frame.statistics.accuracy is not None
    assert alone.statistics.accuracy is not None
    assert frame.statistics.accuracy.step == alone.statistics.accuracy.step
    assert frame.image is not None
    assert alone.image is not None
    assert compare(frame.image, alone.image, 1e-5).count == 0
