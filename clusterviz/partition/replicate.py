"""Every brick on several ranks, one of which draws it: work moves from rank to rank, and data do not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import NOBODY, Owners, owners_of
from clusterviz.partition.tree import BspTree

SWEEPS = 200  # over the shares of a ring; near its end 64 ranks change by less than 1e-3 a sweep


@dataclass(frozen=True, eq=False)
class Replicas:
    """Who holds what, for good.

    Attributes
    ----------
    home : a tree's leaves: bricks of one leaf are held alike
    holders : int64 (leaves, k): the ranks that hold a leaf's bricks, its own first
    """

    home: BspTree
    holders: NDArray[np.int64]

    def holds(self, rank: int) -> NDArray[np.bool_]:
        """The bricks that a rank holds, bool (bz, by, bx)."""
        held: NDArray[np.bool_] = np.any(self.holders == rank, axis=1)[owners_of(self.home).owner]
        return held

    def sums(self, amount: NDArray[np.int64]) -> NDArray[np.int64]:
        """Each rank's sum over the bricks that it holds, int64 (ranks,)."""
        leaves = np.array([amount[leaf.box.slices].sum() for leaf in self.home.leaves], np.int64)
        found = np.zeros(self.home.ranks, np.int64)
        np.add.at(found, self.holders, leaves[:, None])
        return found


def replicate(home: BspTree, copies: int) -> Replicas:
    """The static replicated distribution: leaf r's bricks on the ranks r, r + 1, … r + copies − 1, round the ring.

    When to use: the memory of all ranks together holds the data `copies` times. Leaves with neighbouring numbers are
    neighbours in space, and the ring lets work flow through all ranks, each of which keeps a part of its own leaf.

    Raises
    ------
    InputError
        Not 1 … ranks copies.

    References
    ----------
    R. Samanta, T. Funkhouser, K. Li: Parallel rendering with k-way replication, PVG 2001; H.-I. Hsiao, D. DeWitt:
    Chained declustering, ICDE 1990 (the ring).
    """
    if not 1 <= copies <= home.ranks:
        raise InputError("impossible", where="copies", found=copies, allowed=f"1 … {home.ranks}")
    ring = np.arange(home.ranks)[:, None] + np.arange(copies)
    return Replicas(home, ring % home.ranks)


def responsible(replicas: Replicas, cost: Costs) -> Owners:
    """Who draws each brick in a frame: only its holders do, and the busiest rank has as little as shares allow.

    Each leaf is cut across its longest axis into as many parts as it has holders, so that they stay few groups.

    Parameters
    ----------
    cost : float64 (bz, by, bx), expected in this frame; bricks of 0 are nobody's
    """
    leaves = replicas.home.leaves
    totals = np.array([cost[leaf.box.slices].sum() for leaf in leaves])
    shares = even_shares(totals, replicas.holders)
    owner = np.full(cost.shape, NOBODY, np.int32)
    for leaf, share in zip(leaves, shares, strict=True):
        part = cost[leaf.box.slices]
        bricks = np.argwhere(part > 0)
        if len(bricks) == 0:
            continue
        longest = int(np.argmax(np.ptp(bricks, axis=0)))
        others = [axis for axis in range(3) if axis != longest]
        # Along the axis, then to and fro in its layers: each part is layers and at most two pieces of one.
        bricks = bricks[np.lexsort((bricks[:, others[1]], bricks[:, others[0]], bricks[:, longest]))]
        costs = part[tuple(bricks.T)]
        middles = np.cumsum(costs) - costs / 2
        turn = np.searchsorted(np.cumsum(share)[:-1], middles, side="right")
        owner[tuple((bricks + leaf.box.begin_zyx).T)] = replicas.holders[leaf.rank][turn]
    return Owners(replicas.home.ranks, owner)


def even_shares(totals: NDArray[np.float64], holders: NDArray[np.int64]) -> NDArray[np.float64]:
    """How much of each leaf's cost each of its holders takes, so that loads are as even as holders allow.

    Leaf by leaf, its cost is poured again onto its holders as into connected vessels, until nothing flows. The sum of
    squares of the loads is convex and falls in each step.

    Returns
    -------
    shares : float64 (leaves, k), rows sum to `totals`
    """
    shares = np.zeros(holders.shape)
    shares[:, 0] = totals
    loads = np.bincount(holders[:, 0], totals, minlength=int(holders.max()) + 1)
    for _ in range(SWEEPS):
        before = shares.copy()
        for leaf, ranks in enumerate(holders):
            loads[ranks] -= shares[leaf]
            shares[leaf] = _poured(totals[leaf], loads[ranks])
            loads[ranks] += shares[leaf]
        if np.abs(shares - before).max() <= 1e-6 * totals.max(initial=0.0):
            break
    return shares


def _poured(amount: float, levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """What each vessel takes of an amount so that the filled ones stand equally high."""
    by_level = np.sort(levels)
    heights = (amount + np.cumsum(by_level)) / np.arange(1, len(levels) + 1)
    # The highest surface that is over every vessel it fills.
    filled = np.flatnonzero(heights >= by_level)[-1] if amount > 0 else 0
    return np.maximum(0.0, heights[filled] - levels) if amount > 0 else np.zeros_like(levels)
