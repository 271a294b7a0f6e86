"""Closed forms of what algorithms move, beside the counts of their schedules; and how times answer to constants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clusterviz.composite.model.communication import COMMUNICATION_COSTS, ImageStatistics, communication_cost
from clusterviz.composite.model.network import Network, open_network
from clusterviz.composite.model.prediction import place_ranks, predict
from clusterviz.composite.schedules.algorithms import ALGORITHMS
from clusterviz.composite.simulation.loads import count_sparse, direct_send_sparse
from clusterviz.composite.simulation.simulate import cube_footprints

PIXELS = 512 * 512
SWAPS = ("tree", "binary-swap", "binary-swap-telescope", "binary-swap-remainder", "2-3-swap", "radix-k")


def dense(ranks: int, bytes_per_pixel: int = 4) -> ImageStatistics:
    return ImageStatistics(ranks, PIXELS, 1.0, 1.0, bytes_per_pixel, True)


def near(found: float, wanted: float, factor: float) -> bool:
    return bool(wanted / factor <= found <= wanted * factor)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_dense_images_are_counted_exactly_at_powers_of_two_and_else_nearly(algorithm: str) -> None:
    assert list(COMMUNICATION_COSTS) == list(ALGORITHMS)
    for ranks in (2, 4, 8, 16, 64, 128, 3, 5, 6, 7, 11, 31, 100):
        moves, load = (
            COMMUNICATION_COSTS[algorithm](dense(ranks)),
            ALGORITHMS[algorithm](ranks, PIXELS, ()).counts(),
        )
        exact, most = ranks & (ranks - 1) == 0, max(load.pixels_sent.max(), load.pixels_received.max())
        assert abs(moves.rounds - load.rounds) <= (not exact)
        assert moves.pixels_all == pytest.approx(load.pixels_sent.sum(), rel=1e-6 if exact else 0.2)
        assert moves.messages_all == pytest.approx(load.messages_sent.sum(), rel=0 if exact else 0.3)
        if algorithm != "pipeline":  # of which the closed form counts the rounds that wait, too
            assert near(moves.pixels, most, 1.01 if exact else 1.35)
            assert not exact or moves.messages == max(load.messages_sent.max(), load.messages_received.max())
    one = COMMUNICATION_COSTS[algorithm](dense(1))
    assert (one.messages, one.pixels, one.pixels_all, one.gathered) == (0, 0, 0, 0)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_algorithm_without_a_closed_form_is_counted(algorithm: str, monkeypatch: pytest.MonkeyPatch) -> None:
    known = {ranks: COMMUNICATION_COSTS[algorithm](dense(ranks)) for ranks in (2, 8, 64)}
    monkeypatch.delitem(COMMUNICATION_COSTS, algorithm)
    for ranks, form in known.items():
        found = communication_cost(algorithm, dense(ranks))
        assert found.messages_all == form.messages_all
        assert found.pixels_all == pytest.approx(form.pixels_all)
        assert (found.gathered, found.pieces) == (form.gathered, form.pieces)
        if algorithm != "pipeline":  # as above
            assert (found.rounds, found.messages) == (form.rounds, form.messages)
            assert found.pixels == pytest.approx(form.pixels)
    for transport in ("messages", "hierarchical"):
        nodes = ((0, 1), (2, 3)) if transport == "hierarchical" else ((0,), (1,), (2,), (3,))
        assert predict(algorithm, transport, dense(4), place_ranks(range(4), nodes), open_network("laptop")) > 0


@pytest.mark.parametrize("algorithm", ["direct-send", *SWAPS])
def test_bricks_of_a_cube_move_what_the_growing_of_their_unions_says(algorithm: str) -> None:
    for ranks in (2, 4, 8, 16, 31, 64, 100, *((128, 1000) if algorithm == "direct-send" else ())):
        # More rows than strips.
        footprints = cube_footprints(ranks, (512, 512) if ranks < 1000 else (4096, 4096))
        pixels, cover = footprints.canvas_pixels, footprints.count() / footprints.canvas_pixels
        scene = ImageStatistics(ranks, pixels, float(cover.mean()), float(cover.max()), 4, True)
        is_direct = algorithm == "direct-send"
        schedule = None if is_direct else ALGORITHMS[algorithm](ranks, pixels, ())
        load = direct_send_sparse(footprints) if schedule is None else count_sparse(schedule, footprints)
        moves = COMMUNICATION_COSTS[algorithm](scene)
        assert near(moves.pixels_all, load.pixels_sent.sum(), 1.6)
        assert near(moves.pixels, max(load.pixels_sent.max(), load.pixels_received.max()), 1.8)
        assert not is_direct or near(moves.messages_all, load.messages_sent.sum(), 1.7)


def test_between_single_ranks_the_time_is_that_of_the_plain_model() -> None:
    network = Network("", "", 3.0, 5.0, 7e-6, 11e-6)
    ranks = 8
    load = ALGORITHMS["binary-swap"](ranks, PIXELS, ()).counts()
    nodes = tuple((rank,) for rank in range(ranks))
    found = predict("binary-swap", "messages", dense(ranks), place_ranks(range(ranks), nodes), network)
    share = (1 - 1 / ranks) * PIXELS * 4 * 7e-6
    assert found == pytest.approx(network.seconds(load, 4) + 3.0 + 7 * 5.0 + share)


@pytest.mark.parametrize("transport", ["messages", "shared", "hierarchical"])
def test_no_constant_makes_anything_faster_by_growing(transport: str) -> None:
    network = open_network("laptop")
    nodes = ((0, 1, 2, 3), (4, 5, 6, 7)) if transport != "shared" else (tuple(range(8)),)
    places = place_ranks(range(8), nodes)
    before = predict("direct-send", transport, dense(8), places, network)
    times = [name for name in vars(network) if "seconds" in name]
    grown = [predict("direct-send", transport, dense(8), places, replace(network, **{name: 1.0})) for name in times]
    assert min(grown) >= before
    assert sum(seconds > before for seconds in grown) >= 3


def test_ranks_that_share_cores_take_longer() -> None:
    network = open_network("laptop")
    places = place_ranks(range(8), (tuple(range(8)),))
    for transport in ("messages", "shared"):
        times = [
            predict("direct-send", transport, dense(8), places, replace(network, cores=cores)) for cores in (8, 4, 2, 1)
        ]
        assert times == sorted(times)
        assert times[-1] > 2 * times[0]


def test_ranks_of_a_node_share_its_link() -> None:
    network = Network("", "", 0.0, 0.0, 1.0, 0.0, node_seconds_per_byte=0.0)
    apart = predict("direct-send", "messages", dense(8), place_ranks(range(8), tuple((r,) for r in range(8))), network)
    pairs = tuple((r, r + 1) for r in range(0, 8, 2))
    together = predict("direct-send", "messages", dense(8), place_ranks(range(8), pairs), network)
    merged = predict("direct-send", "hierarchical", dense(8), place_ranks(range(8), pairs), network)
    assert merged < apart < together


def test_floats_take_longer_than_bytes() -> None:
    network, places = open_network("laptop"), place_ranks(range(4), ((0, 1, 2, 3),))
    for transport in ("messages", "shared"):
        byte, half, single = (predict("direct-send", transport, dense(4, size), places, network) for size in (4, 8, 16))
        assert byte < half <= single


def test_places() -> None:
    nodes = ((0, 1, 2), (3, 4), (5,))
    places = place_ranks([0, 3, 1, 4], nodes)
    assert (places.all_nodes, places.most, places.nodes) == (3, 3, 2)
    assert (places.ranks, places.strips, places.busy, places.interleaved) == (3, 2, 2, True)
    assert not place_ranks([1, 0, 4], nodes).interleaved
    assert place_ranks([], nodes).busy == 0
    nothing, laptop = ImageStatistics(0, 0, 1.0, 1.0, 4, True), open_network("laptop")
    assert not np.isnan(predict("direct-send", "shared", nothing, place_ranks([], nodes), laptop))
