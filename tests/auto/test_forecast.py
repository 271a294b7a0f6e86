"""Cost probe and forecasts: the samples of each rank, and the mode that is chosen by them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from auto.scenes import INSTANT, NODES, OPAQUE, RANKS, SLOW, SOURCE, opened_on, scene_of
from frame.views import on_ranks

from clusterviz.auto.cost_probe import REPEATS, CostProbe, drawing_seconds, probe_cost, samples_of_ranks
from clusterviz.auto.mode import choose, forecast, held_bytes
from clusterviz.comm import Channel, run_loopback
from clusterviz.distribution.contract import candidates
from clusterviz.distribution.memory_budget import MemoryBudget
from clusterviz.frame import Run
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.loop import planned
from clusterviz.frame.work import RankWork
from clusterviz.image import PartialImage
from clusterviz.partition.screen import rank_groups
from clusterviz.plan.plan import Plan
from clusterviz.report.decisions import Forecast
from clusterviz.report.statistics import RankFrame


def probe_of(settings: dict[str, Any]) -> tuple[Plan, CostProbe]:
    """What a pre-pass finds."""

    def job(channel: Channel) -> tuple[Plan, CostProbe | None]:
        run, scene, opened, drawing = opened_on(channel, settings)
        plan = opened.plan(scene)
        return plan, planned(drawing, probe_cost(run, scene, plan))

    told = run_loopback(RANKS, job)
    assert [probe is None for _, probe in told] == [False, True, True, True]
    plan, probe = told[0]
    assert probe is not None
    assert probe.seconds_per_sample > 0
    assert probe.ranks_per_core >= 1
    return plan, probe


def sounded(settings: dict[str, Any]) -> tuple[Plan, CostProbe]:
    """What a pre-pass finds, at a nanosecond a sample and a core a rank."""
    plan, probe = probe_of(settings)
    return plan, replace(probe, seconds_per_sample=1e-9, ranks_per_core=1.0)


@pytest.fixture(scope="module")
def opaque() -> tuple[Plan, CostProbe]:
    return sounded(OPAQUE)


@pytest.fixture(scope="module")
def clear() -> tuple[Plan, CostProbe]:
    return sounded({})


def drawn(settings: dict[str, Any]) -> list[int]:
    """What ranks really take."""

    (frame,) = on_ranks(RANKS, [scene_of(settings)], SOURCE, device="cpu")
    return [rank.samples - rank.samples_estimate for rank in frame.statistics.per_rank]


def test_samples_of_ranks_are_foreseen(opaque: tuple[Plan, CostProbe]) -> None:
    """By early ends of rays, too: in sort-last each rank's own, in sort-first all that lies in front."""
    plan, probe = opaque
    last, both, first = (samples_of_ranks(probe, plan, rank_groups(RANKS, groups)) for groups in (1, 2, RANKS))
    assert last == pytest.approx(drawn(OPAQUE | {"mode": "sort-last"}), rel=0.12)
    assert first.sum() == pytest.approx(sum(drawn(OPAQUE | {"mode": "sort-first"})), rel=0.12)
    found = drawn(OPAQUE | {"mode": "hybrid", "groups": 2, "tiling": "estimated"})
    assert both.sum() == pytest.approx(sum(found), rel=0.12)
    assert both.max() == pytest.approx(max(found), rel=0.2)
    assert last.sum() > 1.4 * first.sum()


def test_what_is_opaque_asks_for_the_screen_to_be_shared(opaque: tuple[Plan, CostProbe]) -> None:
    plan, probe = opaque
    found = [forecast(plan, MemoryBudget(), NODES, groups, INSTANT, probe) for groups in (1, 2, RANKS)]
    assert found[0].samples > 1.2 * found[2].samples
    assert choose(found) == RANKS


def test_what_is_clear_and_even_stays_sort_last(clear: tuple[Plan, CostProbe]) -> None:
    """Whoever draws it, the samples are the same, and sharing the screen then gains little."""
    plan, probe = clear
    found = [forecast(plan, MemoryBudget(), NODES, groups, INSTANT, probe) for groups in candidates(RANKS)]
    total = [samples_of_ranks(probe, plan, rank_groups(RANKS, each.groups)).sum() for each in found]
    assert total == pytest.approx([total[0]] * len(total), rel=1e-3)
    few = [replace(each, seconds_compositing=0.0, seconds_drawing=each.samples) for each in found]
    assert few[-1].seconds < few[0].seconds
    assert choose([replace(few[0], seconds_drawing=few[-1].seconds * 1.1), *few[1:]]) == 1


def test_slow_links_ask_for_pixels_that_travel_once(clear: tuple[Plan, CostProbe]) -> None:
    plan, probe = clear
    assert choose([forecast(plan, MemoryBudget(), NODES, groups, SLOW, probe) for groups in candidates(RANKS)]) == RANKS


@pytest.mark.parametrize("groups", [1, 2, RANKS])
def test_pixels_of_fewer_bits_take_less_to_join(clear: tuple[Plan, CostProbe], groups: int) -> None:
    plan, probe = clear
    slow = replace(SLOW, seconds_per_byte=1e-3)
    full, half, quarter = (
        forecast(plan, MemoryBudget(), NODES, groups, slow, probe, pixel).seconds_compositing
        for pixel in ("float32", "float16", "uint8")
    )
    assert full == pytest.approx(2 * half, rel=1e-3)
    assert full == pytest.approx(4 * quarter, rel=1e-3)


def test_dear_samples_and_dear_links_weigh_against_each_other(opaque: tuple[Plan, CostProbe]) -> None:
    """The time of a sample is that of the device: where it is short, compositing decides."""
    plan, probe = opaque
    quick, slow = (
        forecast(plan, MemoryBudget(), NODES, 1, SLOW, replace(probe, seconds_per_sample=each))
        for each in (1e-12, 1e-4)
    )
    assert quick.seconds_compositing == slow.seconds_compositing > quick.seconds_drawing
    assert slow.seconds_drawing > slow.seconds_compositing
    assert slow.seconds_drawing == pytest.approx(1e-4 * slow.samples)


def test_ranks_that_share_cores_wait_for_all_of_them(clear: tuple[Plan, CostProbe]) -> None:
    """Uneven samples cost nothing as long as every core has something to do."""
    samples, crowded = np.array([1.0, 3.0, 2.0, 2.0]), replace(clear[1], seconds_per_sample=4.0, ranks_per_core=4.0)
    assert drawing_seconds(replace(crowded, ranks_per_core=1.0), samples, NODES) == 12
    assert drawing_seconds(crowded, samples, ((0, 1, 2, 3),)) == 8
    assert drawing_seconds(crowded, samples, ((0, 2), (1, 3))) == 10


def test_more_groups_hold_more(clear: tuple[Plan, CostProbe]) -> None:
    held = [held_bytes(clear[0], MemoryBudget(), RANKS, groups) for groups in candidates(RANKS)]
    assert held == sorted(held)
    assert held[-1] > 2 * held[0]


@pytest.mark.parametrize("ranks", [1, 2, 3, 5, 7, 8, 64, 1000])
def test_numbers_of_groups_that_are_compared(ranks: int) -> None:
    found = candidates(ranks)
    assert found == sorted(set(found))
    assert (found[0], found[-1]) == (1, ranks)
    assert len(found) <= 40
    assert ranks != 3 or 2 in found


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


@pytest.mark.cover
@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_look_that_others_held_up_is_not_believed(late: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what a sample takes, the shortest time is what the device takes for it."""
    draw, drawn = Drawing.draw, [0] * RANKS

    def held_up(self: Drawing, run: Run, work: RankWork) -> tuple[list[PartialImage], RankFrame]:
        found = draw(self, run, work)
        drawn[run.channel.rank] += 1
        if drawn[run.channel.rank] == 2 + late:  # the first is the coarse picture
            run.clock.add("render", 1e4)
        return found

    monkeypatch.setattr(Drawing, "draw", held_up)
    _, probe = probe_of({})
    assert drawn == [1 + REPEATS] * RANKS
    assert 0 < probe.seconds_per_sample < 1e-3


@pytest.mark.parametrize("seconds", [1e-12, 1e-9, 1e-6, 1e-3])
def test_what_is_better_in_both_is_chosen_whatever_a_sample_takes(seconds: float) -> None:
    """A busy machine measures longer samples, and begins with the same mode unless samples stand against messages."""

    def way(groups: int, samples: float, compositing: float) -> Forecast:
        return Forecast(groups, samples, seconds * samples, compositing, 0)

    assert choose([way(1, 1e5, 1e-3), way(4, 0.89e5, 0.89e-3)]) == 4
    assert choose([way(1, 1e5, 1e-3), way(4, 0.91e5, 0.91e-3)]) == 1
