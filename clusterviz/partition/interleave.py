"""Static interleaved distribution: neighbouring bricks on different ranks, so that all share expensive regions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import UNASSIGNED, Owners


def interleave(cost: Costs, ranks: int, block: int = 1) -> Owners:
    """Return the static interleaved distribution.

    When to use: the cost is not known or changes, and data must not move. When not: nearly every block of bricks is a
    separate image to composite.

    Returns blocks with a cost, assigned round robin along a Z curve; numbers of blocks differ by at most one.

    Reference: M. Strengert 2010, section 5.3.6, static - interleaved; P. Campbell et al.: Dynamic octree load balancing
    using space-filling curves, Williams College CS-03-01, 2003.

    `cost`: float64 (bz, by, bx); bricks of cost 0 are not assigned. `block`: side of the assigned blocks, in bricks;
    larger blocks make fewer images, and balance less well.
    """
    drawn = np.argwhere(cost > 0)
    keys = _z_curve(drawn // block)
    _, turn = np.unique(keys, return_inverse=True)
    owner = np.full(cost.shape, UNASSIGNED, np.int32)
    owner[tuple(drawn.T)] = turn.reshape(-1) % ranks
    return Owners(ranks, owner)


def _z_curve(places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the position of each block along the Z curve: the interleaved bits of its three indices."""
    keys = np.zeros(len(places), np.int64)
    for bit in range(21):
        for axis in range(3):
            keys |= (places[:, axis] >> bit & 1) << (3 * bit + 2 - axis)
    return keys
