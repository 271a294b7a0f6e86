"""Bricks dealt round robin in space: neighbours go to different ranks, so that a dear region is dear for all alike."""

from __future__ import annotations

import numpy as np

from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import NOBODY, Owners


def interleave(cost: Costs, ranks: int, block: int = 1) -> Owners:
    """The static interleaved distribution.

    When to use: the cost is not known and moves, and data must not. When not: every block of bricks is an image of its
    own to composite, nearly whatever the camera.

    Parameters
    ----------
    cost : float64 (bz, by, bx): bricks that cost nothing are nobody's, and are not counted in dealing
    ranks : to whom, 1 or more
    block : bricks along the side of what is dealt: larger ones make fewer images, and balance less well

    Returns
    -------
    owners : blocks with a cost, in the order of a Z curve, to ranks in turn; no rank has over one more than another

    Raises
    ------
    InputError
        `ranks` or `block` below 1.

    References
    ----------
    M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.6,
    static - interleaved; P. Campbell et al.: Dynamic octree load balancing using space-filling curves, Williams College
    CS-03-01, 2003.
    """
    if min(ranks, block) < 1:
        raise InputError("nothing to deal by", where="ranks and block", found=(ranks, block), allowed="1 or more")
    drawn = np.argwhere(cost > 0)
    keys = _z_curve(drawn // block)
    _, turn = np.unique(keys, return_inverse=True)
    owner = np.full(cost.shape, NOBODY, np.int32)
    owner[tuple(drawn.T)] = turn.reshape(-1) % ranks
    return Owners(ranks, owner)


def _z_curve(
    places: np.ndarray[tuple[int, ...], np.dtype[np.int64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """The place of each block along the curve: the bits of its three indices in turn."""
    keys = np.zeros(len(places), np.int64)
    for bit in range(21):
        for axis in range(3):
            keys |= (places[:, axis] >> bit & 1) << (3 * bit + 2 - axis)
    return keys
