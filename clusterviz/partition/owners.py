"""Owners: the rank that draws each brick, for any distribution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.bsp import Costs
from clusterviz.partition.tree import BspTree

UNASSIGNED = -1


@dataclass(frozen=True, eq=False)
class Owners:
    """The rank that draws each brick."""

    ranks: int  # number of ranks, with or without bricks
    owner: NDArray[np.int32]  # int32 (bz, by, bx), 0 … ranks − 1, or `UNASSIGNED` for a brick that is not drawn

    def bricks(self, rank: int) -> NDArray[np.int64]:
        """Return a rank's bricks, int64 (m, 3), indices (z, y, x) in array order."""
        return np.argwhere(self.owner == rank)

    def loads(self, cost: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return each rank's sum of a cost per brick, float64 (ranks,)."""
        drawn = self.owner != UNASSIGNED
        return np.asarray(np.bincount(self.owner[drawn], cost[drawn], minlength=self.ranks), np.float64)

    def sums(self, amount: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return each rank's sum of an integer per brick, such as its bytes; int64 (ranks,)."""
        found = np.zeros(self.ranks, np.int64)
        drawn = self.owner != UNASSIGNED
        np.add.at(found, self.owner[drawn], amount[drawn])
        return found

    def imbalance(self, cost: NDArray[np.float64]) -> float:
        """Return the largest over the mean load; 1 if all costs are 0."""
        loads = self.loads(cost)
        return float(loads.max() / loads.mean()) if loads.sum() > 0 else 1.0


def owners_of(tree: BspTree) -> Owners:
    """Return the owners of the static coherent distribution: each brick belongs to its leaf, whatever it costs."""
    owner = np.empty(tree.shape_zyx, np.int32)
    for leaf in tree.leaves:
        owner[leaf.box.slices] = leaf.rank
    return Owners(tree.ranks, owner)


def bricks_of(tree: BspTree, rank: int, cost: Costs) -> NDArray[np.int64]:
    """Return the bricks that a rank loads and draws: those of its leaf with a cost above 0.

    `cost` is float64 (bz, by, bx). The bricks, int64 (m, 3), indices (z, y, x), are in array order, as on disk.
    """
    box = tree.leaves[rank].box
    bricks: NDArray[np.int64] = np.argwhere(cost[box.slices] > 0) + np.array(box.begin_zyx, np.int64)
    return bricks
