"""Fits find the constants that made the times, whatever a quarter of the times suffered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clusterviz.composite.model.communication import ImageStatistics
from clusterviz.composite.model.fitting import fit_line, fit_link, fit_program
from clusterviz.composite.model.network import Network, open_network
from clusterviz.composite.model.prediction import place_ranks, predict

SIZES = (0, 64, 1 << 10, 1 << 12, 1 << 14, 1 << 16, 1 << 18, 1 << 20, 1 << 22, 1 << 24)
LARGE = SIZES[5:]
COUNTS = (1, 2, 4, 8, 16)


def test_a_line_with_a_point_that_is_far_off_and_one_that_falls() -> None:
    points = {n: 3.0 + 0.5 * n for n in (1, 2, 5, 9, 12, 20)} | {7: 1000.0}
    assert fit_line(points) == pytest.approx((3.0, 0.5))
    assert fit_line({1: 5.0, 2: 4.0, 3: 3.0}) == (4.0, 0.0)


@pytest.mark.parametrize(
    ("latency", "overhead", "per_byte"), [(2e-6, 1e-6, 5e-11), (3e-5, 6e-6, 8.4e-10), (0.0, 4e-6, 1e-10)]
)
@pytest.mark.parametrize("seed", range(5))
def test_the_constants_of_a_link_with_noise(latency: float, overhead: float, per_byte: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    by_size = {size: (latency + overhead + size * per_byte) * rng.uniform(1.0, 1.05) for size in SIZES}
    by_count = {count: (2 * latency + count * overhead) * rng.uniform(1.0, 1.02) for count in COUNTS}
    link = fit_link(by_size, by_count, {size: by_size[size] * rng.uniform(1.0, 1.05) for size in LARGE})
    assert link.seconds_per_byte == pytest.approx(per_byte, rel=0.1)
    assert link.overhead_seconds == pytest.approx(overhead, rel=0.25)
    assert link.latency_seconds + link.overhead_seconds == pytest.approx(latency + overhead, rel=0.1)
    assert link.error < 0.1


def test_one_size_that_was_disturbed_shows_only_in_the_worst_error() -> None:
    by_size = {size: 3e-6 + size * 1e-10 for size in SIZES}
    by_size[1 << 20] *= 10
    by_count = {count: 2e-6 + count * 1e-6 for count in COUNTS}
    link = fit_link(by_size, by_count, {size: by_size[size] for size in LARGE})
    assert (link.latency_seconds, link.overhead_seconds) == pytest.approx((2e-6, 1e-6))
    assert link.seconds_per_byte == pytest.approx(1e-10)
    assert link.error == pytest.approx(0.0, abs=1e-9)
    assert link.worst_error > 5


def test_a_burst_slower_than_a_ping_pong_leaves_no_negative_latency() -> None:
    by_size = {size: 1e-6 + size * 1e-10 for size in SIZES}
    link = fit_link(by_size, {count: count * 5e-6 for count in COUNTS}, {size: by_size[size] for size in LARGE})
    assert (link.latency_seconds, link.overhead_seconds) == pytest.approx((0.0, 1e-6))


@pytest.mark.parametrize("nodes", [((0, 1, 2, 3),), ((0, 1), (2, 3)), ((0,), (1,), (2,), (3,))])
@pytest.mark.parametrize("cores", [0, 2, 4])
def test_the_costs_of_the_program(nodes: tuple[tuple[int, ...], ...], cores: int) -> None:
    plain = replace(open_network("laptop"), cores=cores, frame_seconds=0.0, message_seconds=0.0)
    wanted = replace(plain, frame_seconds=2e-4, message_seconds=5e-5)
    tiny = {ranks: _tiny(ranks, nodes, wanted) for ranks in (1, 2, 4)}
    found = fit_program(plain, nodes, tiny, 256)
    assert found.frame_seconds == pytest.approx(2e-4, rel=0.01)
    assert found.message_seconds == pytest.approx(5e-5, rel=0.01)


def _tiny(ranks: int, nodes: tuple[tuple[int, ...], ...], network: Network) -> float:
    scene = ImageStatistics(ranks, 256, 1.0, 1.0, 4, True)
    return predict("direct-send", "messages", scene, place_ranks(range(ranks), nodes), network)


def test_swaps_say_what_a_byte_costs_when_both_ways_share_memory() -> None:
    by_size = {size: 3e-6 + size * 1e-10 for size in SIZES}
    link = fit_link(by_size, {count: count * 1e-6 for count in COUNTS}, {size: 3e-6 + size * 2e-10 for size in LARGE})
    assert link.seconds_per_byte == pytest.approx(2e-10)
    assert link.seconds(1, 1 << 20) == pytest.approx(3e-6 + (1 << 20) * 2e-10, rel=1e-3)
