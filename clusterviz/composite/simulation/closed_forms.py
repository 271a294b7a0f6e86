"""Loads of algorithms with n² transfers, computed without their schedules: 65,536 ranks make 4·10⁹ of them.

Each of these equals the count of the schedule itself for small numbers of ranks, which the tests check.
"""

from __future__ import annotations

import numpy as np

from clusterviz.composite.schedules.direct_send import choose_pieces
from clusterviz.composite.schedules.load import Load
from clusterviz.composite.schedules.schedule import Indices, borders


def direct_send_dense(ranks: int, pixels: int, owners: int | None = None, bands: int | None = None) -> Load:
    """Everybody sends each owner its pieces. SLIC deals dense images in just this way."""
    owner, cuts = choose_pieces(ranks, pixels, None, owners, bands)
    own = np.zeros(ranks, np.int64)
    np.add.at(own, owner, np.diff(cuts))
    owns = (own > 0).astype(np.int64)
    moving = ranks > 1
    return Load(
        int(moving and pixels > 0),
        moving * (owns.sum() - owns),
        (ranks - 1) * owns,
        moving * (pixels - own),
        (ranks - 1) * own,
    )


def parallel_pipeline_dense(ranks: int, pixels: int) -> Load:
    """A rank sends every piece but its own once; pieces that pass it are those of owners two ranks away and more."""
    own = np.diff(borders(ranks, pixels))
    owns = (own > 0).astype(np.int64)
    position = np.arange(ranks, dtype=np.int64)
    full = position[own > 0]
    rounds = int(np.maximum(full, ranks - 1 - full).max(initial=0))
    moving = ranks > 1
    sent = moving * (owns.sum() - owns)
    return Load(rounds, sent, _passing(owns), moving * (pixels - own), _passing(own))


def _passing(own: Indices) -> Indices:
    """What each rank receives, where its own piece counts `own`: once from either end of the line, and what passes."""
    ranks = len(own)
    position = np.arange(ranks)
    before = np.concatenate([[0], np.cumsum(own)])
    passing = before[-1] - before[np.minimum(position + 2, ranks)] + before[np.maximum(position - 1, 0)]
    return np.asarray(passing + own * ((position > 0).astype(np.int64) + (position < ranks - 1)), np.int64)
