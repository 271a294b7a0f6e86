"""Scaling pages: points and rounds of a measurement, forecasts, imbalance, and the sentences of the verdict."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clusterviz.comm import Channel, run_loopback
from clusterviz.composite import ALGORITHMS, Compositor
from clusterviz.composite.model.communication import ImageStatistics
from clusterviz.composite.model.network import open_network
from clusterviz.image.compare import compare
from clusterviz.image.partial import PartialImage, Rect
from clusterviz.pages.scale.forecast import (
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
from clusterviz.pages.scale.measure import Measured, RankResources, measure, measured_from_json
from clusterviz.pages.scale.points import (
    STRONG,
    WEAK,
    Point,
    as_json,
    count_rounds,
    dense_bytes,
    make_balance,
    make_point,
    oversubscription,
    with_efficiency,
)
from clusterviz.pages.scale.survey import FailedJob, SurveyResult
from clusterviz.pages.scale.verdict import verdict
from clusterviz.report.statistics import STAGES, RankFrame
from clusterviz.scene import Cluster, scene_of_data
from clusterviz.scene.overrides import with_settings


def seat(host: str, cores: int, gpu: int | None = None) -> RankResources:
    return RankResources(host, tuple(range(cores)), gpu)


def measured(render: list[list[float]], samples: list[int], resources: list[RankResources] | None = None) -> Measured:
    """A job with drawing times by frame, then rank; a frame takes 0.1 s more than its slowest rank draws."""
    ranks = len(samples)
    frames = [
        [
            RankFrame(
                dict.fromkeys(STAGES, 0.0) | {"render": seconds, "total": max(times) + 0.1, "cpu": seconds},
                bricks=2,
                samples=count,
                compositing={"algorithm": "tree", "transport": "shared", "codec": "raw", "seconds_predicted": 0.02},
            )
            for seconds, count in zip(times, samples, strict=True)
        ]
        for times in render
    ]
    once = [{"plan": 1.0 + rank, "load": 2.0, "context": 0.0, "shaders": 0.0} for rank in range(ranks)]
    rects = ([(0, 0, 10, 10), (5, 0, 20, 10), (0, 0, 0, 0), (0, 10, 20, 20)] * 2)[:ranks]
    everywhere = resources or [seat("here", ranks)] * ranks
    order = list(range(ranks))[::-1]
    return Measured(frames, once, 0.5, everywhere, order, rects, "tree", [[]] * ranks, (32, 24), 1.0, 16)


@pytest.mark.parametrize(
    ("resources", "said"),
    [
        ([seat("a", 4)] * 4, ""),
        ([seat("a", 4)] * 5, "5 ranks on 4 cores"),
        ([seat("a", 1)] * 2, "2 ranks on 1 core"),
        ([seat("a", 2), seat("a", 2), seat("b", 2), seat("b", 2)], ""),
        ([seat("a", 2), seat("b", 2), seat("b", 2), seat("b", 2)], "3 ranks on 2 cores"),
        # Bound to cores of their own.
        ([RankResources("a", (0,), None), RankResources("a", (1,), None)], ""),
        ([RankResources("a", (0,), None), RankResources("a", (0,), None)], "2 ranks on 1 core"),
        ([seat("a", 8, 0), seat("a", 8, 1)], ""),
        ([seat("a", 8, 0), seat("a", 8, 0)], "2 ranks on 1 GPU"),
        ([seat("a", 8, 0), seat("b", 8, 0)], ""),
    ],
)
def test_ranks_that_take_turns_are_found(resources: list[RankResources], said: str) -> None:
    assert oversubscription(resources) == said


def test_times_are_of_the_slowest_rank_and_the_median_frame() -> None:
    point = make_point(STRONG, measured([[1.0, 3.0], [9.0, 2.0], [4.0, 5.0]], [10, 30]), None)
    assert point.render_seconds == 5.0
    assert (point.total_seconds, point.total_seconds_min, point.total_seconds_max) == (5.1, 3.1, 9.1)
    assert point.render_mean_seconds == 4.5
    assert point.imbalance == (1.5, 18 / 11, 10 / 9)
    assert point.imbalance_samples == 1.5
    assert (point.seconds["plan"], point.seconds["finish"]) == (2.0, 0.5)
    assert point.draw_seconds == (1.0, 2.0)
    assert point.cpu_seconds == 9.0
    assert (point.algorithm, point.transport, point.predicted_seconds) == ("tree", "shared", 0.02)


def test_what_is_composited_leaves_out_ranks_that_see_nothing() -> None:
    images = make_point(STRONG, measured([[1.0] * 4], [1] * 4), None).images
    assert (images.images, images.pixels, images.bytes_per_pixel) == (3, 400, 16)
    assert images.cover == pytest.approx((100 + 150 + 200) / 3 / 400)
    assert images.largest == 0.5
    assert not images.front_is_root


def test_efficiency_is_against_the_first_that_has_cores_of_its_own() -> None:
    points = [make_point(STRONG, measured([[0.9 / n] * n], [8] * n), None) for n in (1, 2, 4)]
    crowded = [replace(points[0], crowded="2 ranks on 1 core"), *points[1:]]
    found = [point.efficiency for point in with_efficiency(points)]
    assert found == pytest.approx([1.0, 1.0 / (2 * 0.55), 1.0 / (4 * 0.325)])
    assert [point.efficiency for point in with_efficiency(crowded)] == [None, 1.0, pytest.approx(1.1 / 1.3)]
    weak = [replace(point, scaling=WEAK) for point in points]
    assert [point.efficiency for point in with_efficiency(weak)] == pytest.approx([1.0, 1 / 0.55, 1 / 0.325])
    all_crowded = [replace(point, crowded="so") for point in points]
    assert [point.efficiency for point in with_efficiency(all_crowded)] == [None] * 3


def test_nothing_drawn_divides_by_nothing() -> None:
    nothing = replace(measured([[0.0, 0.0]], [0, 0]), rects=[(0, 0, 0, 0)] * 2)
    point = make_point(STRONG, nothing, None)
    assert (point.imbalance_samples, point.images.images, point.rounds, point.bytes_dense) == (1.0, 0, (), 0)


def test_jobs_and_points_walk_through_json() -> None:
    job = measured([[1.0, 3.0]], [10, 30])
    assert measured_from_json(json.loads(json.dumps(job.as_json()))) == job
    assert json.loads(json.dumps(as_json(make_point(STRONG, job, None))))["imbalance_samples"] == 1.5


IMAGES = ImageStatistics(4, 10**6, 0.4, 0.5, 16, True)
NETWORK = open_network("infiniband-200g")
MACHINE = Machine(NETWORK, NETWORK, 8)
BLACK = np.zeros((2, 2, 4), np.float32)


def point(ranks: int, render: list[float], samples: list[int], collect: float = 0.0, crowded: str = "") -> Point:
    """A point that drew in software, undisturbed; what it takes beside drawing is collecting."""
    slowest, mean = max(render), sum(render) / ranks
    return replace(
        make_point(STRONG, measured([render], samples), compare(BLACK, BLACK, 1e-5)),
        crowded=crowded,
        seconds=dict.fromkeys(STAGES, 0.0) | {"render": slowest, "collect": collect},
        total_seconds=slowest + collect,
        total_seconds_min=slowest,
        total_seconds_max=slowest + 2 * collect,
        cpu_seconds=mean * ranks,
        compositing_seconds=collect,
        efficiency=None if crowded else 0.5,
        images=IMAGES,
        renderer="llvmpipe",
        software=True,
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


def test_frames_of_an_orbit_are_told_one_by_one() -> None:
    found = make_balance("dynamic", measured([[1.0, 3.0], [2.0, 2.0], [0.0, 0.0]], [10, 30]))
    assert found.imbalance == (1.5, 1.0, 1.0)
    assert found.imbalance_samples == (1.5,) * 3
    assert found.busiest_samples == (30,) * 3
    assert [(row["frame"], row["distribution"], row["ranks"]) for row in found.rows()] == [
        (number, "dynamic", 2) for number in range(3)
    ]


def test_the_first_sentence_names_imbalance_where_it_takes_most() -> None:
    shares = ([1, 1, 1, 87], [25, 25, 25, 25])
    uneven, even = (make_point(STRONG, measured([[9.0] * 4], samples), None) for samples in shares)
    balance = tuple(make_balance(name, measured([[1.0, 3.0]], [10, 30])) for name in ("coherent", "dynamic"))
    said = verdict(SurveyResult((uneven,), (), (), balance), CURVE, "a network")
    assert said[0].startswith("The bottleneck is imbalance: 73% of a frame of 9.1 s on 4 ranks")
    assert "busiest of 2 ranks takes this multiple of the mean samples: 1.50 (coherent) and 1.50 (dynamic)." in said[1]
    plain = verdict(SurveyResult((even,), (), ()), CURVE, "a network")
    assert plain[0].startswith("The bottleneck is drawing: 99% of a frame of 9.1 s on 4 ranks")
    assert not any("orbit" in sentence for sentence in plain)


SMALL = {"size": (40, 30), "brick": 8, "opacity": 0.2}


@pytest.mark.gl
@pytest.mark.parametrize(
    ("settings", "sharing", "images"),
    [
        ({"mode": "sort-last"}, "sort-last", 1),
        ({"mode": "sort-first", "tiling": "interleaved", "tile": 8}, "sort-first", 0),
        ({"groups": 2, "tiling": "temporal"}, "hybrid, 2 groups", 1),
    ],
)
def test_any_way_to_share_is_measured(settings: dict[str, Any], sharing: str, images: int) -> None:
    """Tiles that do not overlap are many images a rank, which no visibility order names one by one."""
    scene = with_settings(scene_of_data("field:gaussian:16"), SMALL | settings)
    found = run_loopback(3, lambda channel: measure(scene, channel, 1, lambda *_: None, warm_up=0))[0]
    assert found.sharing == sharing
    assert [len(sent) > 0 for sent in found.counted] == [bool(images)] * 3
    assert (found.algorithm != "") == bool(images)
    assert sum(rank.samples for rank in found.frames[0]) > 0
    assert measured_from_json(found.as_json()) == found


SIZE = (40, 30)
RECTS = [(3, 2, 20, 17), (10, 5, 38, 25), (0, 0, 0, 0), (1, 12, 15, 28), (22, 3, 39, 11), (12, 12, 30, 30)]


def sent(algorithm: str, rects: Sequence[tuple[int, int, int, int]], order: list[int]) -> Measured:
    """What ranks in one process send of images with these rectangles."""

    def rank(channel: Channel) -> list[tuple[int, int]]:
        rect = Rect(*rects[channel.rank])
        image = PartialImage(rect, np.full((rect.height, rect.width, 4), 0.25, np.float32))
        compositor = Compositor(channel, SIZE, algorithm=algorithm, codec="raw", transport="messages")
        _, counters = compositor.composite(image, order)
        compositor.close()
        return [(stage.messages_sent, stage.pixels_sent) for stage in counters.stages]

    counted = run_loopback(len(rects), rank)
    resources = [RankResources("here", (0,), None)] * len(rects)
    return Measured([], [], 0.0, resources, order, list(rects), algorithm, counted, SIZE, 1.0, 16)


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_every_algorithm_sends_what_theory_says(algorithm: str) -> None:
    measured = sent(algorithm, RECTS, [3, 0, 5, 2, 1, 4])
    rounds = count_rounds(measured)
    assert all(one.agrees for one in rounds), rounds
    assert sum(one.messages for one in rounds) > 0
    assert 0 < sum(one.bytes for one in rounds) <= dense_bytes(measured)


def test_a_message_that_was_not_sent_is_seen() -> None:
    measured = sent("direct-send", RECTS[:3], [0, 1, 2])
    measured.counted[0][0] = (measured.counted[0][0][0] - 1, measured.counted[0][0][1])
    assert [one.agrees for one in count_rounds(measured)] == [False]


@pytest.mark.parametrize("rects", [RECTS[:1], [RECTS[2], RECTS[0], RECTS[2]], [RECTS[2]] * 2])
def test_one_image_or_none_needs_no_message(rects: list[tuple[int, int, int, int]]) -> None:
    measured = sent("binary-swap", rects, list(range(len(rects))))
    assert (count_rounds(measured), dense_bytes(measured)) == ((), 0)
