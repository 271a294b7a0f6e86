"""Whether the ranks can hold their shares, and how many ranks could: asked before anything is loaded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError

Shares = Callable[[int], NDArray[np.int64]]
"""Bytes of bricks that each of a number of ranks would hold, int64 (ranks,)."""


def check_memory(shares: Shares, ranks: int, brick_bytes: NDArray[np.int64], limit_bytes: int | None) -> None:
    """Refuse a limit below the largest share.

    Parameters
    ----------
    shares : of the distribution
    ranks : how many there are
    brick_bytes : int64 (bz, by, bx), 0 for bricks that are not held
    limit_bytes : of bricks a rank; None: any

    Raises
    ------
    InputError
        It names the largest share, and a number of ranks that would do, if any does.
    """
    if limit_bytes is None:
        return
    most = int(shares(ranks).max())
    if most <= limit_bytes:
        return
    if int(brick_bytes.max()) > limit_bytes:
        remedy = f"smaller bricks: one takes {int(brick_bytes.max())} bytes, which no number of ranks changes"
    elif enough := fitting_ranks(shares, ranks, brick_bytes, limit_bytes):
        remedy = f"{enough} ranks, or {most} bytes a rank"
    else:
        remedy = f"{most} bytes a rank"
    raise InputError(
        f"the largest share of {ranks} {'rank' if ranks == 1 else 'ranks'} takes {most} bytes",
        where="cluster.memory_limit",
        found=f"{limit_bytes} bytes a rank",
        allowed=remedy,
    )


def fitting_ranks(shares: Shares, above: int, brick_bytes: NDArray[np.int64], limit_bytes: int) -> int | None:
    """A number of ranks above one that fails, with which every share fits; None where none was found.

    Doubled until it fits, then halved down: the answer was tried. Shares need not fall with every single rank more, so
    a smaller number might do as well. More ranks than bricks do not help.
    """
    bricks = int(np.count_nonzero(brick_bytes))
    fails, fits = above, max(above + 1, -(-int(brick_bytes.sum()) // max(1, limit_bytes)))
    while int(shares(fits).max()) > limit_bytes:
        if fits >= bricks:
            return None
        fails, fits = fits, min(2 * fits, bricks)
    while fits - fails > 1:
        middle = (fails + fits) // 2
        if int(shares(middle).max()) > limit_bytes:
            fails = middle
        else:
            fits = middle
    return fits
