"""Who shares a node, and nodes that are pretended to be smaller."""

from __future__ import annotations

import pytest

from clusterviz.comm import run_loopback
from clusterviz.comm.agreed import is_agreed
from clusterviz.comm.nodes import group_by_node, ranks_per_node
from clusterviz.errors import InputError


@pytest.mark.parametrize(
    ("firsts", "ranks_each", "nodes"),
    [
        ([0], None, ((0,),)),
        ([0, 0, 2, 2, 2], None, ((0, 1), (2, 3, 4))),
        ([0, 1, 0, 1, 0], None, ((0, 2, 4), (1, 3))),
        ([0, 1, 0, 1, 0], 2, ((0, 2), (1, 3), (4,))),
        ([0] * 7, 3, ((0, 1, 2), (3, 4, 5), (6,))),
        ([0] * 3, 9, ((0, 1, 2),)),
        ([0] * 3, 1, ((0,), (1,), (2,))),
    ],
)
def test_each_rank_is_on_one_node(
    firsts: list[int], ranks_each: int | None, nodes: tuple[tuple[int, ...], ...]
) -> None:
    assert group_by_node(firsts, ranks_each) == nodes


def test_a_silent_variable_pretends_nothing() -> None:
    assert ranks_per_node(None) is None
    assert ranks_per_node("") is None
    assert ranks_per_node("12") == 12


@pytest.mark.parametrize("text", ["0", "-2", "2.5", "two", "²", " 2"])
def test_a_size_that_cannot_be_is_refused_by_all(text: str) -> None:
    with pytest.raises(InputError, match=r"CLUSTERVIZ_RANKS_PER_NODE: .*a positive integer") as caught:
        ranks_per_node(text)
    assert is_agreed(caught.value)


def test_threads_pretend_nodes_but_tell_their_true_place() -> None:
    found = run_loopback(5, lambda channel: (channel.nodes(), channel.place().local_size), ranks_per_node=2)
    assert found == [(((0, 1), (2, 3), (4,)), 5)] * 5
