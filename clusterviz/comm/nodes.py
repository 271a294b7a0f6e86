"""Which ranks share a node; and a way to pretend that nodes are smaller, so that one machine can stand for many.

Only who shares memory is pretended. Where a rank really runs (`place`) stays true, since cores and GPUs depend on it.
"""

from __future__ import annotations

from collections.abc import Sequence

from clusterviz.comm.agreed import mark_agreed
from clusterviz.errors import InputError

RANKS_PER_NODE_VARIABLE = "CLUSTERVIZ_RANKS_PER_NODE"

Nodes = tuple[tuple[int, ...], ...]


def ranks_per_node(text: str | None) -> int | None:
    """How many ranks a pretended node has, as the environment variable says it; None where it says nothing.

    Raises
    ------
    InputError
        No positive integer. Marked as agreed on: every rank is given the same text.
    """
    if not text:
        return None
    if not (text.isascii() and text.isdigit() and int(text)):
        raise mark_agreed(
            InputError("wrong size of a node", where=RANKS_PER_NODE_VARIABLE, found=text, allowed="a positive integer")
        )
    return int(text)


def group_by_node(firsts: Sequence[int], ranks_each: int | None = None) -> Nodes:
    """The ranks of each node, in order, nodes by their first ranks.

    Parameters
    ----------
    firsts : the lowest rank on the node of each rank
    ranks_each : cut each node into pretended ones of so many ranks; the last of them may have fewer
    """
    real: dict[int, list[int]] = {}
    for rank, first in enumerate(firsts):
        real.setdefault(first, []).append(rank)
    return tuple(
        sorted(
            tuple(ranks[begin : begin + (ranks_each or len(ranks))])
            for ranks in real.values()
            for begin in range(0, len(ranks), ranks_each or len(ranks))
        )
    )
