"""Loads of algorithms with n² transfers, computed without their schedules: 65,536 ranks make 4·10⁹ of them.

Each of these equals the count of the schedule itself for small numbers of ranks, which the tests check.
"""

from __future__ import annotations

import numpy as np

from clusterviz.composite.direct_send import choose_owners
from clusterviz.composite.load import Load
from clusterviz.composite.rectangles import Rectangles
from clusterviz.composite.schedule import Indices, borders

RANKS_AT_ONCE = 4096


def direct_send_dense(ranks: int, pixels: int, owners: int | None = None) -> Load:
    """Everybody sends each owner its piece. SLIC deals dense images in just this way."""
    owner, cuts = _owners(ranks, pixels, choose_owners(ranks, owners))
    own = np.zeros(ranks, np.int64)
    own[owner] = np.diff(cuts)
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


def direct_send_sparse(footprints: Rectangles, owners: int | None = None) -> Load:
    """Row by row of each footprint: which pieces it touches, and how much of each."""
    ranks, pixels = len(footprints), footprints.canvas_pixels
    owners = choose_owners(ranks, owners)
    owner, cuts = _owners(ranks, pixels, owners)
    sent = np.zeros(ranks, np.int64)
    senders, total = np.zeros(owners + 1, np.int64), np.zeros(owners + 1, np.int64)
    for begin in range(0, ranks, RANKS_AT_ONCE):
        rank, start, end = footprints.rows(begin, min(begin + RANKS_AT_ONCE, ranks))
        first, last = ((start + 1) * owners - 1) // pixels, (end * owners - 1) // pixels
        # A piece that reaches from one row of a footprint into the next is one message.
        again = (np.diff(rank, prepend=-1) == 0) & (first == np.concatenate([[-1], last[:-1]]))
        np.add.at(sent, rank, last - first + 1 - again)
        np.add.at(senders, first + again, 1)
        np.subtract.at(senders, last + 1, 1)
        total += _before(start, cuts) - _before(end, cuts)
    own = np.zeros(ranks, np.int64)
    own[owner] = footprints.take(owner).cut(cuts[:-1], cuts[1:]).count()
    received, pixels_received = np.zeros(ranks, np.int64), np.zeros(ranks, np.int64)
    received[owner], pixels_received[owner] = np.cumsum(senders)[:-1], np.diff(total)
    received, sent = received - (own > 0), sent - (own > 0)
    return Load(int(sent.any()), sent, received, footprints.count() - own, pixels_received - own)


def _before(numbers: Indices, cuts: Indices) -> Indices:
    """For each cut, the sum of its distances from all smaller numbers."""
    numbers = np.sort(numbers)
    sums = np.concatenate([[0], np.cumsum(numbers)])
    index = np.searchsorted(numbers, cuts)
    return np.asarray(index * cuts - sums[index], np.int64)


def _owners(ranks: int, pixels: int, owners: int) -> tuple[Indices, Indices]:
    """The ranks that own pieces, and where the pieces begin and end."""
    return np.arange(owners, dtype=np.int64) * ranks // max(owners, 1), borders(owners, pixels)
