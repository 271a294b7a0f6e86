"""Who draws each brick, as a value: what every distribution comes down to, whether it is a tree or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.tree import BspTree

NOBODY = -1


@dataclass(frozen=True, eq=False)
class Owners:
    """Each brick's one drawing rank; a partition by its form, whatever stands in it.

    Attributes
    ----------
    ranks : how many there are, with bricks or without
    owner : int32 (bz, by, bx), 0 … ranks − 1, or `NOBODY` for a brick that is not drawn

    Raises
    ------
    InputError
        `owner` is not a 3-D array of such numbers.
    """

    ranks: int
    owner: NDArray[np.int32]

    def __post_init__(self) -> None:
        if self.owner.ndim != 3 or self.owner.size == 0:
            raise InputError("not an array over bricks", where="owner", found=f"shape {self.owner.shape}")
        low, high = int(self.owner.min()), int(self.owner.max())
        if low < NOBODY or high >= self.ranks:
            raise InputError("no such rank", where="owner", found=f"{low} … {high}", allowed=f"−1 … {self.ranks - 1}")

    def bricks(self, rank: int) -> NDArray[np.int64]:
        """A rank's bricks, int64 (m, 3), indices (z, y, x) in array order."""
        return np.argwhere(self.owner == rank)

    def loads(self, cost: NDArray[np.float64]) -> NDArray[np.float64]:
        """Each rank's sum of a cost per brick, float64 (ranks,)."""
        drawn = self.owner != NOBODY
        return np.asarray(np.bincount(self.owner[drawn], cost[drawn], minlength=self.ranks), np.float64)

    def sums(self, amount: NDArray[np.int64]) -> NDArray[np.int64]:
        """Each rank's sum of a whole number per brick, such as its bytes; int64 (ranks,)."""
        found = np.zeros(self.ranks, np.int64)
        drawn = self.owner != NOBODY
        np.add.at(found, self.owner[drawn], amount[drawn])
        return found

    def imbalance(self, cost: NDArray[np.float64]) -> float:
        """Largest over mean load; 1 where nothing costs anything."""
        loads = self.loads(cost)
        return float(loads.max() / loads.mean()) if loads.sum() > 0 else 1.0


def owners_of(tree: BspTree) -> Owners:
    """The static coherent distribution: every brick, one that costs nothing too, is its leaf's."""
    owner = np.empty(tree.shape_zyx, np.int32)
    for leaf in tree.leaves:
        owner[leaf.box.slices] = leaf.rank
    return Owners(tree.ranks, owner)
