"""Replicated distribution: every brick is held by several ranks, one of which draws it, so that no data moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import UNASSIGNED, Owners, owners_of
from clusterviz.partition.tree import BspTree

SWEEPS = 200  # at most; near the end the shares of 64 ranks change by less than 1e-3 a sweep


@dataclass(frozen=True, eq=False)
class Replicas:
    """Static assignment of bricks to several ranks each."""

    home: BspTree  # tree whose leaves are replicated as a whole
    holders: NDArray[np.int64]  # int64 (leaves, k), ranks that hold a leaf's bricks, its own first

    def holds(self, rank: int) -> NDArray[np.bool_]:
        """Return the bricks that a rank holds, bool (bz, by, bx)."""
        held: NDArray[np.bool_] = np.any(self.holders == rank, axis=1)[owners_of(self.home).owner]
        return held

    def sums(self, amount: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return each rank's sum over the bricks that it holds, int64 (ranks,)."""
        leaves = np.array([amount[leaf.box.slices].sum() for leaf in self.home.leaves], np.int64)
        found = np.zeros(self.home.ranks, np.int64)
        np.add.at(found, self.holders, leaves[:, None])
        return found


def replicate(home: BspTree, copies: int) -> Replicas:
    """Return the static replicated distribution: the bricks of leaf r on the ranks r, …, r + copies − 1 of a ring.

    When to use: the memory of all ranks together can hold the data `copies` times. Leaves with neighbouring numbers are
    neighbours in space, and the ring lets work move between all ranks, each of which keeps a part of its own leaf.

    Reference: R. Samanta, T. Funkhouser, K. Li: Parallel rendering with k-way replication, PVG 2001; H.-I. Hsiao, D.
    DeWitt: Chained declustering, ICDE 1990 (the ring).
    """
    ring = np.arange(home.ranks)[:, None] + np.arange(copies)
    return Replicas(home, ring % home.ranks)


def assign_replicas(replicas: Replicas, cost: Costs) -> Owners:
    """Assign each brick of a frame to one of its holders, so that the largest load is as small as possible.

    Each leaf is cut across its longest axis into as many parts as it has holders, so that there are few groups.

    `cost`: float64 (bz, by, bx), expected cost in this frame; bricks of cost 0 are not assigned.
    """
    leaves = replicas.home.leaves
    totals = np.array([cost[leaf.box.slices].sum() for leaf in leaves])
    shares = even_shares(totals, replicas.holders)
    owner = np.full(cost.shape, UNASSIGNED, np.int32)
    for leaf, share in zip(leaves, shares, strict=True):
        part = cost[leaf.box.slices]
        bricks = np.argwhere(part > 0)
        if len(bricks) == 0:
            continue
        longest = int(np.argmax(np.ptp(bricks, axis=0)))
        others = [axis for axis in range(3) if axis != longest]
        # Along the axis, then within its layers: each part is whole layers and at most two partial ones.
        bricks = bricks[np.lexsort((bricks[:, others[1]], bricks[:, others[0]], bricks[:, longest]))]
        costs = part[tuple(bricks.T)]
        middles = np.cumsum(costs) - costs / 2
        turn = np.searchsorted(np.cumsum(share)[:-1], middles, side="right")
        owner[tuple((bricks + leaf.box.begin_zyx).T)] = replicas.holders[leaf.rank][turn]
    return Owners(replicas.home.ranks, owner)


def even_shares(totals: NDArray[np.float64], holders: NDArray[np.int64]) -> NDArray[np.float64]:
    """Divide each leaf's cost among its holders, so that loads are as even as the holders allow.

    Each leaf's cost in turn is divided anew so that the loads of its holders become equal, until nothing changes. The
    sum of squares of the loads is convex and decreases in each step.

    Returns float64 (leaves, k), rows sum to `totals`.
    """
    shares = np.zeros(holders.shape)
    shares[:, 0] = totals
    loads = np.bincount(holders[:, 0], totals, minlength=int(holders.max()) + 1)
    for _ in range(SWEEPS):
        before = shares.copy()
        for leaf, ranks in enumerate(holders):
            loads[ranks] -= shares[leaf]
            shares[leaf] = _fill_levels(totals[leaf], loads[ranks])
            loads[ranks] += shares[leaf]
        if np.abs(shares - before).max() <= 1e-6 * totals.max(initial=0.0):
            break
    return shares


def _fill_levels(amount: float, levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the parts of an amount that raise the lowest levels to one height (water filling)."""
    by_level = np.sort(levels)
    heights = (amount + np.cumsum(by_level)) / np.arange(1, len(levels) + 1)
    # The largest number of levels that lie below the height of their filling.
    filled = np.flatnonzero(heights >= by_level)[-1] if amount > 0 else 0
    return np.maximum(0.0, heights[filled] - levels) if amount > 0 else np.zeros_like(levels)
