"""Points of scaling curves; none is rated on oversubscribed cores."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from clusterviz.report.pages.scale.measure import Measured, RankResources, measured_from_json
from clusterviz.report.pages.scale.points import STRONG, WEAK, as_json, make_point, oversubscription, with_efficiency
from clusterviz.report.statistics import STAGES, RankFrame


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
    rects = [(0, 0, 10, 10), (5, 0, 20, 10), (0, 0, 0, 0), (0, 10, 20, 20)][:ranks]
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
