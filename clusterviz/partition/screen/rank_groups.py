"""The ranks in groups that share the screen; inside a group the ranks share the data."""

from __future__ import annotations

from itertools import pairwise

from clusterviz.errors import InputError

RankGroups = tuple[tuple[int, ...], ...]


def rank_groups(ranks: int, groups: int) -> RankGroups:
    """Neighbouring ranks, which are likely to share a node, in groups whose sizes differ by at most one.

    Raises
    ------
    InputError
        Fewer groups than 1, or more than ranks.
    """
    if not 1 <= groups <= ranks:
        raise InputError("groups without ranks", where="cluster.groups", found=groups, allowed=f"1 … {ranks}")
    edges = [number * ranks // groups for number in range(groups + 1)]
    return tuple(tuple(range(begin, end)) for begin, end in pairwise(edges))
