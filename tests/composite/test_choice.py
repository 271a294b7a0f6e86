"""auto is sensible at the extremes, fixed names are respected, and what cannot be is refused the same everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from composite.cases import compose, random_case

from clusterviz.composite.footprints import Footprint, Footprints
from clusterviz.composite.model.choice import HANDICAPS, Request, choose, fastest
from clusterviz.composite.model.network import Network, open_network, shipped_networks
from clusterviz.composite.schedules import binary_tree
from clusterviz.composite.schedules.algorithms import ALGORITHMS, SEVERAL_IMAGES
from clusterviz.composite.simulation.simulate import cube_footprints
from clusterviz.errors import InputError
from clusterviz.image.partial import EMPTY, Rect

AUTO = Request("auto", "auto", "auto")
MESSAGES = Request("auto", "messages", "raw")
HD = Rect(0, 0, 1920, 1080)
TRANSPORTS = ("messages", "shared", "hierarchical", "auto")
Nodes = tuple[tuple[int, ...], ...]


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


def apart(ranks: int) -> Nodes:
    return tuple((rank,) for rank in range(ranks))


def together(ranks: int, each: int | None = None) -> Nodes:
    each = each or ranks
    return tuple(tuple(range(begin, min(begin + each, ranks))) for begin in range(0, ranks, each))


@pytest.fixture(params=shipped_networks())
def network(request: pytest.FixtureRequest) -> Network:
    return open_network(request.param)


def test_ranks_of_one_node_share_memory(network: Network) -> None:
    for ranks in (2, 3, 4, 8):
        for rects in ([HD] * ranks, bricks(ranks, (1024, 1024))):
            assert choose(AUTO, footprints(rects), together(ranks), network).transport == "shared"


@pytest.mark.parametrize(
    ("wanted", "rects", "nodes", "algorithm", "transport"),
    [
        (AUTO, [HD] * 2, apart(2), "direct-send", "messages"),
        (AUTO, [Rect(0, 0, 2, 2)] * 8, apart(8), "tree", "messages"),
        (Request("auto", "hierarchical", "raw"), [HD] * 4, apart(4), None, "messages"),
        (Request("binary-swap", "shared", "raw"), [HD] * 4, together(4), "direct-send", "shared"),
        *((Request("auto", each, "raw"), [HD], ((0,),), "direct-send", "messages") for each in TRANSPORTS),
    ],
    ids=["two nodes", "tiny images", "one rank a node", "shared is direct send", *(f"one: {it}" for it in TRANSPORTS)],
)
def test_what_is_chosen_on_any_network(
    wanted: Request, rects: list[Rect], nodes: Nodes, algorithm: str | None, transport: str, network: Network
) -> None:
    choice = choose(wanted, footprints(rects, np.float32 if len(rects) == 2 else np.uint8), nodes, network)
    assert choice.algorithm == (algorithm or choice.algorithm)
    assert (choice.transport, choice.codec) == (transport, "raw" if len(rects) == 1 else choice.codec)


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


@pytest.mark.parametrize("nodes", [together(4), apart(4), together(4, 2)])
def test_all_empty_and_all_but_one_empty(network: Network, nodes: Nodes) -> None:
    for rects in ([EMPTY] * 4, [EMPTY, EMPTY, Rect(3, 4, 5, 6), EMPTY]):
        choice = choose(AUTO, footprints(rects), nodes, network)
        assert choice.algorithm in ALGORITHMS
        assert 0 <= choice.seconds_predicted < 0.01


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("nodes", [together(6), apart(6), together(6, 3), together(6, 4)])
def test_a_named_algorithm_runs_and_has_a_prediction(algorithm: str, nodes: Nodes) -> None:
    network = open_network("laptop")
    for rects in ([HD] * 6, bricks(6, (300, 200)), [HD, *[EMPTY] * 5]):
        choice = choose(Request(algorithm, "auto", "lz4"), footprints(rects), nodes, network)
        assert (choice.algorithm, choice.codec) == (algorithm, "lz4")
        assert choice.transport in ("messages", "hierarchical")
        assert 0 < choice.seconds_predicted < 60


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


def test_several_images_a_rank_go_by_what_takes_them() -> None:
    network = open_network("laptop")
    found = footprints([HD] * 6, ranks=[0, 1, 2, 0, 1, 2])
    for name in ("auto", *ALGORITHMS):
        ran = name if name in SEVERAL_IMAGES else "direct-send"
        assert choose(Request(name, "messages", "raw"), found, apart(3), network).algorithm == ran
    # A node between the images of another is several images, too; nodes may be lists.
    lists, swap = [[0, 1], [2, 3]], Request("binary-swap", "hierarchical", "raw")
    found, in_line = footprints([HD] * 4, ranks=[0, 2, 1, 3]), footprints([HD] * 4)
    assert choose(replace(swap, algorithm="auto"), found, lists, network).algorithm == "direct-send"
    assert choose(swap, found, lists, network).algorithm == "direct-send"
    assert choose(swap, in_line, lists, network).algorithm == "binary-swap"
    assert choose(AUTO, in_line, lists, network) == choose(AUTO, in_line, together(4, 2), network)


@pytest.mark.parametrize(
    ("wanted", "nodes", "text"),
    [
        (Request("auto", "shared", "raw"), together(4, 2), "cluster.transport.*messages, hierarchical, auto"),
        (Request("auto", "shared", "raw"), apart(4), "cluster.transport.*found shared; allowed messages, auto"),
        (Request("auto", "pigeons", "raw"), together(4), f"unknown transport.*{', '.join(TRANSPORTS)}"),
        (Request("swap", "messages", "raw"), together(4), "unknown compositing algorithm.*direct-send"),
    ],
)
def test_what_cannot_be_is_refused(wanted: Request, nodes: Nodes, text: str) -> None:
    with pytest.raises(InputError, match=text):
        choose(wanted, footprints([HD] * 4), nodes, open_network("laptop"))


def test_an_algorithm_without_a_closed_form_runs_if_named_and_is_tried_by_auto(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ALGORITHMS, "own", lambda *of: binary_tree.schedule(*of))
    network, tiny, large = open_network("laptop"), footprints([Rect(0, 0, 2, 2)] * 8), footprints([HD] * 8)
    assert choose(Request("own", "messages", "raw"), large, apart(8), network).algorithm == "own"
    fastest.cache_clear()
    # It moves what a tree does, without the tree's handicap.
    assert choose(MESSAGES, tiny, apart(8), network).algorithm == "own"
    assert choose(MESSAGES, large, apart(8), network).algorithm != "own"
    case = random_case(5)
    case.check(compose(case, "own")[0], 4)
    fastest.cache_clear()
