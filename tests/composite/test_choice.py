"""auto is sensible at the extremes, fixed names are respected, and what cannot be is refused the same everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clusterviz.composite.footprints import Footprint, Footprints
from clusterviz.composite.model.choice import HANDICAPS, Choice, Request, choose
from clusterviz.composite.model.network import Network, open_network, shipped_networks
from clusterviz.composite.schedules.algorithms import ALGORITHMS, SEVERAL_IMAGES
from clusterviz.composite.simulation.cubes import cube_footprints
from clusterviz.errors import InputError
from clusterviz.image.region import EMPTY, Rect

AUTO = Request("auto", "auto", "auto")
MESSAGES = Request("auto", "messages", "raw")
HD = Rect(0, 0, 1920, 1080)


def footprints(rects: Sequence[Rect], dtype: Any = np.uint8, ranks: Sequence[int] | None = None) -> Footprints:
    """Images from front to back, of these ranks."""
    ranks = range(len(rects)) if ranks is None else ranks
    layers = tuple(Footprint(rank, 0, rect, 0) for rank, rect in zip(ranks, rects, strict=True) if rect.pixels)
    canvas = EMPTY
    for layer in layers:
        canvas = canvas.unite(layer.rect)
    return Footprints(canvas, np.dtype(dtype), layers, tuple(dict.fromkeys(layer.rank for layer in layers)))


def bricks(ranks: int, size: tuple[int, int]) -> list[Rect]:
    columns = cube_footprints(ranks, size).columns()[2:]
    return [Rect(*sides) for sides in zip(*(column.tolist() for column in columns), strict=True)]


def apart(ranks: int) -> tuple[tuple[int, ...], ...]:
    return tuple((rank,) for rank in range(ranks))


def together(ranks: int, each: int | None = None) -> tuple[tuple[int, ...], ...]:
    each = each or ranks
    return tuple(tuple(range(begin, min(begin + each, ranks))) for begin in range(0, ranks, each))


@pytest.fixture(params=shipped_networks())
def network(request: pytest.FixtureRequest) -> Network:
    return open_network(request.param)


def test_ranks_of_one_node_share_memory(network: Network) -> None:
    for ranks in (2, 3, 4, 8):
        for rects in ([HD] * ranks, bricks(ranks, (1024, 1024))):
            assert choose(AUTO, footprints(rects), together(ranks), network).transport == "shared"


def test_two_ranks_on_two_nodes_swap_halves_of_large_images(network: Network) -> None:
    choice = choose(AUTO, footprints([HD] * 2, np.float32), apart(2), network)
    assert (choice.algorithm, choice.transport) == ("direct-send", "messages")


def test_tiny_images_go_through_a_tree(network: Network) -> None:
    assert choose(AUTO, footprints([Rect(0, 0, 2, 2)] * 8), apart(8), network).algorithm == "tree"


def test_many_ranks_with_large_dense_images_swap(network: Network) -> None:
    large = Rect(0, 0, 4096, 4096)
    for ranks in (1000, 4096):
        choice = choose(AUTO, footprints([large] * ranks, np.float32), apart(ranks), network)
        assert choice.algorithm not in ("direct-send", "tree", "serial")
        assert choice.transport == "messages"


def test_bricks_of_a_cube_are_sent_directly_and_dense_images_not_so_on_a_slow_link() -> None:
    slow = replace(open_network("ethernet-10g"), seconds_per_byte=1e-8)
    sparse = choose(MESSAGES, footprints(bricks(32, (2048, 2048))), apart(32), slow)
    assert sparse.algorithm == "direct-send"
    dense = choose(MESSAGES, footprints([HD] * 32), apart(32), replace(slow, message_seconds=1e-2))
    assert dense.algorithm in ("binary-swap", "tree")


def test_nodes_of_several_ranks_merge_inside_first() -> None:
    network = open_network("ethernet-10g")
    choice = choose(AUTO, footprints([HD] * 16, np.float32), together(16, 4), network)
    assert choice.transport == "hierarchical"
    assert choose(AUTO, footprints([HD] * 16), together(16, 4), network, memory_shared=False).transport == "messages"


@pytest.mark.parametrize("nodes", [together(4), apart(4), together(4, 2)])
def test_all_empty_and_all_but_one_empty(network: Network, nodes: tuple[tuple[int, ...], ...]) -> None:
    for rects in ([EMPTY] * 4, [EMPTY, EMPTY, Rect(3, 4, 5, 6), EMPTY]):
        choice = choose(AUTO, footprints(rects), nodes, network)
        assert choice.algorithm in ALGORITHMS
        assert 0 <= choice.seconds_predicted < 0.01


def test_one_rank_needs_no_memory_in_common(network: Network) -> None:
    for transport in ("auto", "messages", "shared", "hierarchical"):
        choice = choose(Request("auto", transport, "raw"), footprints([HD]), ((0,),), network)
        assert choice == Choice("direct-send", "messages", "raw", choice.seconds_predicted)


def test_hierarchical_over_single_ranks_is_messages(network: Network) -> None:
    choice = choose(Request("auto", "hierarchical", "raw"), footprints([HD] * 4), apart(4), network)
    assert choice.transport == "messages"


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("nodes", [together(6), apart(6), together(6, 3), together(6, 4)])
def test_a_named_algorithm_runs_and_has_a_prediction(algorithm: str, nodes: tuple[tuple[int, ...], ...]) -> None:
    network = open_network("laptop")
    for rects in ([HD] * 6, bricks(6, (300, 200)), [HD, *[EMPTY] * 5]):
        choice = choose(Request(algorithm, "auto", "lz4"), footprints(rects), nodes, network)
        assert (choice.algorithm, choice.codec) == (algorithm, "lz4")
        assert choice.transport in ("messages", "hierarchical")
        assert 0 < choice.seconds_predicted < 60


def test_the_shared_transport_is_direct_send_whatever_is_named() -> None:
    wanted = Request("binary-swap", "shared", "raw")
    choice = choose(wanted, footprints([HD] * 4), together(4), open_network("laptop"))
    assert (choice.algorithm, choice.transport) == ("direct-send", "shared")


def test_auto_is_the_least_prediction_of_what_it_may_take(network: Network) -> None:
    for rects in ([HD] * 7, bricks(7, (800, 600))):
        found = footprints(rects)
        best = choose(AUTO, found, together(7, 4), network).seconds_predicted
        for transport in ("messages", "hierarchical"):
            for algorithm in ("direct-send", "binary-swap-telescope", "binary-swap-remainder", "2-3-swap"):
                fixed = choose(Request(algorithm, transport, "auto"), found, together(7, 4), network)
                assert fixed.seconds_predicted >= best


def test_a_tree_has_to_win_clearly() -> None:
    network = open_network("laptop")
    for side in range(8, 2048, 40):
        found = footprints([Rect(0, 0, side, side)] * 8)
        taken = choose(MESSAGES, found, apart(8), network)
        other, tree = (
            choose(Request(name, "messages", "raw"), found, apart(8), network).seconds_predicted
            for name in ("binary-swap", "tree")
        )
        if taken.algorithm == "tree":
            assert HANDICAPS["tree"] * tree <= other
        else:
            assert taken.seconds_predicted <= other


def test_lists_of_nodes_and_repeated_calls_give_the_same() -> None:
    network, found = open_network("laptop"), footprints([HD] * 4)
    lists = [list(ranks) for ranks in together(4, 2)]
    assert choose(AUTO, found, lists, network) == choose(AUTO, found, together(4, 2), network)


def test_several_images_a_rank_go_by_what_takes_them() -> None:
    network = open_network("laptop")
    found = footprints([HD] * 6, ranks=[0, 1, 2, 0, 1, 2])
    assert choose(MESSAGES, found, apart(3), network, interleaved=True).algorithm == "direct-send"
    for name in ALGORITHMS:
        wanted = Request(name, "messages", "raw")
        ran = name if name in SEVERAL_IMAGES else "direct-send"
        assert choose(wanted, found, apart(3), network, interleaved=True).algorithm == ran


def test_a_node_between_the_images_of_another_is_several_images() -> None:
    network = open_network("ethernet-10g")
    found = footprints([HD] * 4, ranks=[0, 2, 1, 3])
    assert choose(Request("auto", "hierarchical", "raw"), found, together(4, 2), network).algorithm == "direct-send"
    swap = Request("binary-swap", "hierarchical", "raw")
    assert choose(swap, found, together(4, 2), network).algorithm == "direct-send"
    in_line = footprints([HD] * 4)
    assert choose(swap, in_line, together(4, 2), network).algorithm == "binary-swap"


@pytest.mark.parametrize(
    ("wanted", "nodes", "window", "text"),
    [
        (Request("auto", "shared", "raw"), together(4, 2), True, "cluster.transport.*messages, hierarchical, auto"),
        (Request("auto", "shared", "raw"), apart(4), True, "cluster.transport.*found shared; allowed messages, auto"),
        (Request("auto", "shared", "raw"), together(4), False, "cluster.transport.*allowed messages, auto"),
        (Request("auto", "hierarchical", "raw"), together(4, 2), False, "cluster.transport.*allowed messages, auto"),
        (
            Request("auto", "pigeons", "raw"),
            together(4),
            True,
            "unknown transport.*messages, shared, hierarchical, auto",
        ),
        (Request("swap", "messages", "raw"), together(4), True, "unknown compositing algorithm.*direct-send"),
    ],
)
def test_what_cannot_be_is_refused(
    wanted: Request, nodes: tuple[tuple[int, ...], ...], window: bool, text: str
) -> None:
    with pytest.raises(InputError, match=text):
        choose(wanted, footprints([HD] * 4), nodes, open_network("laptop"), memory_shared=window)
