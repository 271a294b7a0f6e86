"""Forecasts of frames, and the sentences of the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clusterviz.composite.model.communication import ImageStatistics
from clusterviz.composite.model.network import open_network
from clusterviz.image.compare import compare
from clusterviz.report.pages.scale.forecast import (
    MAX_RANKS,
    Machine,
    PredictedFrame,
    Rates,
    crossover_ranks,
    fit_rates,
    forecast,
    rank_counts,
    sufficient_ranks,
)
from clusterviz.report.pages.scale.points import STRONG, WEAK, Point
from clusterviz.report.pages.scale.survey import FailedJob, SurveyResult
from clusterviz.report.pages.scale.verdict import verdict
from clusterviz.report.statistics import STAGES
from clusterviz.scene import Cluster

IMAGES = ImageStatistics(4, 10**6, 0.4, 0.5, 16, True)
NETWORK = open_network("infiniband-200g")
MACHINE = Machine(NETWORK, NETWORK, 8)
BLACK = np.zeros((2, 2, 4), np.float32)


def point(ranks: int, render: list[float], samples: list[int], collect: float = 0.0, crowded: str = "") -> Point:
    """A point that drew in software, undisturbed; what it takes beside drawing is collecting."""
    slowest, mean = max(render), sum(render) / ranks
    return Point(
        scaling=STRONG,
        ranks=ranks,
        nodes=1,
        step=1.0,
        crowded=crowded,
        seconds=dict.fromkeys(STAGES, 0.0) | {"render": slowest, "collect": collect},
        total_seconds=slowest + collect,
        total_seconds_min=slowest,
        total_seconds_max=slowest + 2 * collect,
        render_mean_seconds=mean,
        cpu_seconds=mean * ranks,
        compositing_seconds=collect,
        predicted_seconds=0.0,
        efficiency=None if crowded else 0.5,
        imbalance=(slowest / mean,),
        samples=tuple(samples),
        draw_seconds=tuple(render),
        sharing="sort-last",
        algorithm="tree",
        transport="messages",
        codec="raw",
        counted_algorithm="tree",
        rounds=(),
        bytes_dense=0,
        bricks=(1,) * ranks,
        voxel_bytes=(1,) * ranks,
        peak_memory_bytes=(1,) * ranks,
        images=IMAGES,
        readback_seconds_per_pixel=0.0,
        renderer="llvmpipe",
        software=True,
        difference=compare(BLACK, BLACK, 1e-5),
    )


ONE, TWO = point(1, [1.0], [1000]), point(2, [0.6, 0.4], [600, 400])


def rates(samples: float = 1e9, fixed: float = 0.0) -> Rates:
    return Rates(fixed, 1e-8, 0.0, {1: samples}, 1.5, IMAGES, False)


def test_drawing_is_a_line_through_the_origin_where_samples_are_alike() -> None:
    found = fit_rates([ONE, TWO])
    assert (found.draw_seconds, found.draw_seconds_per_sample) == (0.0, pytest.approx(1e-3))
    assert found.samples == {1: 1000, 2: 1000}
    assert (found.imbalance, found.crowded) == (1.2, False)


def test_a_fixed_time_is_found_where_samples_differ_enough() -> None:
    eight = point(8, [0.1 + 1e-3 * n for n in range(100, 108)], list(range(100, 108)))
    found = fit_rates([point(1, [0.9], [800]), eight])
    assert (found.draw_seconds, found.draw_seconds_per_sample) == (pytest.approx(0.1), pytest.approx(1e-3))


def test_ranks_that_take_turns_are_fitted_only_where_there_are_no_others() -> None:
    slow = point(2, [5.0, 5.0], [500, 500], crowded="2 ranks on 1 core")
    assert fit_rates([ONE, slow]).draw_seconds_per_sample == pytest.approx(1e-3)
    assert not fit_rates([ONE, slow]).crowded
    alone = fit_rates([slow])
    assert (alone.draw_seconds_per_sample, alone.crowded) == (pytest.approx(1e-2), True)


def test_samples_that_opaque_parts_add_are_kept() -> None:
    found = fit_rates([point(1, [1.0], [1000]), point(4, [0.5] * 4, [500] * 4)])
    assert found.samples == {1: 1000, 4: 2000}
    one, two, four, eight = forecast(replace(found, imbalance=1.0), MACHINE, Cluster(), False, [1, 2, 4, 8])
    each = found.draw_seconds_per_sample
    assert one.draw_seconds == pytest.approx(1000 * each)
    assert two.draw_seconds == pytest.approx(750 * each)
    assert (four.draw_seconds, eight.draw_seconds) == (pytest.approx(500 * each), pytest.approx(250 * each))


def test_strong_drawing_shrinks_and_weak_drawing_stays() -> None:
    counts = rank_counts()
    assert (counts[0], counts[-1], len(counts)) == (1, MAX_RANKS, 17)
    strong, weak = (forecast(rates(), MACHINE, Cluster(), weakly, counts) for weakly in (False, True))
    assert strong[0].draw_seconds == weak[0].draw_seconds == pytest.approx(10.0)
    assert [one.draw_seconds for one in strong[1:]] == pytest.approx([15.0 / n for n in counts[1:]])
    assert [one.draw_seconds for one in weak[1:]] == pytest.approx([15.0] * 16)
    # What is composited is the same.
    assert [one.compositing_seconds for one in strong] == [one.compositing_seconds for one in weak]
    assert all(0 < one.compositing_seconds < 1 for one in strong)


def test_the_scene_may_name_algorithm_and_transport() -> None:
    for name, transport in (("binary-swap", "messages"), ("radix-k", "hierarchical")):
        cluster = Cluster(compositing=name, transport=transport)
        found = forecast(rates(), MACHINE, cluster, False, [2, 64, 4096])
        assert [one.algorithm for one in found] == [name] * 3
        assert [one.transport for one in found] == ["messages", transport, transport]


def test_named_is_never_faster_than_auto() -> None:
    counts = [16, 256, 4096]
    auto = forecast(rates(), MACHINE, Cluster(), False, counts)
    swap = forecast(rates(), MACHINE, Cluster(compositing="binary-swap"), False, counts)
    assert all(a.compositing_seconds <= b.compositing_seconds for a, b in zip(auto, swap, strict=True))


def test_where_curves_cross() -> None:
    curve = [PredictedFrame(n, 1.0 / n, 0.01 * n**0.5, "tree", "messages") for n in rank_counts(1024)]
    assert crossover_ranks(curve) == 32
    assert crossover_ranks(curve[:4]) is None
    assert sufficient_ranks(curve).ranks == min(curve, key=lambda one: one.total_seconds).ranks
    flat = [PredictedFrame(n, 1.0 + 0.001 / n, 0.0, "tree", "messages") for n in rank_counts(1024)]
    assert sufficient_ranks(flat).ranks == 1


CURVE = [PredictedFrame(n, 1.0 / n, 0.001 * n, "tree", "messages") for n in rank_counts(1024)]


def said(*points: Point, failed: tuple[FailedJob, ...] = (), weak: tuple[Point, ...] = ()) -> list[str]:
    return verdict(SurveyResult(points, weak, failed), CURVE, "a network")


def test_the_first_sentence_names_the_bottleneck_and_the_loss() -> None:
    first, *_ = said(ONE, TWO)
    assert first.startswith("The bottleneck is drawing: 83% of a frame of 600 ms on 2 ranks")
    assert "parallel efficiency is 50%, lost mostly to imbalance (100 ms a frame)." in first
    assert "The bottleneck is compositing: 67%" in said(ONE, point(2, [0.5, 0.5], [500, 500], collect=1.0))[0]
    hidden = said(ONE, point(2, [0.8, 0.8], [800, 800]))[0]
    assert "samples behind what another rank shows opaque (300 ms a frame)" in hidden
    assert "drawing that is slower in parts (300 ms a frame)" in said(ONE, point(2, [0.8, 0.8], [500, 500]))[0]


def test_more_than_ideal_is_no_merit_of_the_ranks() -> None:
    """Nothing was lost where a disturbed base makes ranks look five times as good as they are."""
    first, *_ = said(ONE, replace(TWO, efficiency=5.02))
    assert "parallel efficiency is 502%: something slowed down the frames of 1 rank." in first
    assert "lost" not in first


def test_no_efficiency_is_claimed_where_ranks_take_turns() -> None:
    crowded = point(4, [9.0] * 4, [250] * 4, crowded="4 ranks on 2 cores")
    first, second, *_ = said(ONE, TWO, crowded)
    assert "on 2 ranks; parallel efficiency" in first
    assert second == "Oversubscribed, and not used for efficiency: 4 ranks (4 ranks on 2 cores)."
    first, second, *_ = said(crowded)
    assert "efficiency" not in first
    assert second.startswith("Every count is oversubscribed (4 ranks on 2 cores)")


def test_cores_that_other_programs_took_are_told() -> None:
    disturbed = replace(point(2, [0.8, 0.8], [500, 500]), cpu_seconds=0.96)
    first, second, *_ = said(replace(ONE, cpu_seconds=0.9), disturbed)
    assert "lost mostly to drawing that other programs slowed (300 ms a frame)" in first
    assert "as little as 60% of a core each" in second
    assert second.endswith("by CPU time, which they do not lengthen, efficiency is 94%.")
    assert not any("other programs" in sentence.lower() for sentence in said(ONE, replace(disturbed, software=False)))


def test_pictures_that_differ_and_counts_that_failed_are_told() -> None:
    wrong = replace(TWO, difference=compare(BLACK + 0.5, BLACK, 1e-5))
    assert any("THE PICTURES DISAGREE: by up to 5.0e-01 (2 ranks)" in sentence for sentence in said(ONE, wrong))
    assert "The pictures of all rank counts are identical." in said(ONE, TWO)
    assert said(ONE, failed=(FailedJob(WEAK, 7, "killed"),))[-1] == "Not measured: 7 ranks (weak)."
    assert any("compositing takes longer than drawing from 32 ranks on" in sentence for sentence in said(ONE))
