"""Which bricks a rank loads: those of its leaf that cost something."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.tree import BspTree


def bricks_of(tree: BspTree, rank: int, cost: Costs) -> NDArray[np.int64]:
    """The bricks that a rank draws.

    Parameters
    ----------
    tree : built from `cost`, or from other costs over the same bricks
    rank : one of the tree's
    cost : float64 (bz, by, bx)

    Returns
    -------
    bricks : int64 (m, 3), indices (z, y, x), in array order, which is the order on disk

    Raises
    ------
    InputError
        The tree has no such rank, or is over another number of bricks.
    """
    if not 0 <= rank < tree.ranks:
        raise InputError("not in the tree", where="rank", found=rank, allowed=f"0 … {tree.ranks - 1}")
    if cost.shape != tree.shape_zyx:
        raise InputError("not over the tree's bricks", where="cost", found=cost.shape, allowed=tree.shape_zyx)
    box = tree.leaves[rank].box
    bricks: NDArray[np.int64] = np.argwhere(cost[box.slices] > 0) + np.array(box.begin_zyx, np.int64)
    return bricks
