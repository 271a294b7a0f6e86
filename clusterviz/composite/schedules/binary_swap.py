"""Binary swap: neighbours swap halves, then quarters, then eighths; folded for any number of ranks.

What: in round k ranks pair up at distance 2^k; each keeps one half of its range and sends the other. If n is not a
power of two, n − 2^d ranks first send their whole image to the neighbour in front ("fold") and drop out.
When: tens to thousands of ranks with dense images: few messages, and all ranks work.
When not: sparse images, of which direct send moves fewer bytes; n just above a power of two, because of the fold.
Cost, n = 2^d: d rounds, n·d messages; a rank sends and receives (1 − 1/n)·P. With r = n − 2^d folded: one more round, r
+ d·2^d messages; a rank receives at most (2 − 2^−d)·P.
Limits: one partial image a rank, or several adjacent in depth.
Reference: K.-L. Ma et al., "Parallel volume rendering using binary-swap compositing", IEEE CG&A 14(4), 1994. On
folding: K. Moreland, "Comparing binary-swap algorithms for odd factors of processes", LDAV 2018.
"""

from __future__ import annotations

import numpy as np

from clusterviz.composite.schedules.schedule import Indices, Patches, Schedule, Stage, borders


def schedule(ranks: int, pixels: int, footprints: Patches = ()) -> Schedule:
    """Return the schedule: fold to a power of two, then swap."""
    rounds = ranks.bit_length() - 1
    folded = ranks - (1 << rounds) if ranks else 0
    # The first 2·folded ranks pair up, so the swappers remain in visibility order.
    swappers = np.concatenate([np.arange(0, 2 * folded, 2), np.arange(2 * folded, ranks)]).astype(np.int64)
    front = swappers[:folded]
    fold = [Stage.of_columns(front + 1, front, np.array(0), np.array(pixels))] if folded else []
    return Schedule(ranks, pixels, (*fold, *(swap(swappers, round_, pixels) for round_ in range(rounds))))


def swap(swappers: Indices, round_: int, pixels: int) -> Stage:
    """Return round `round_` of 2^d ranks: each of 2^round_ ranges is halved between partners at distance 2^round_."""
    partner = np.arange(len(swappers), dtype=np.int64) ^ (1 << round_)
    cuts, part = borders(2 << round_, pixels), parts(partner, round_ + 1)
    return Stage.of_columns(swappers, swappers[partner], cuts[part], cuts[part + 1])


def parts(index: Indices, bits: int) -> Indices:
    """Return which of 2^bits ranges a rank holds after `bits` rounds: its lowest bits, first round most significant."""
    result = np.zeros_like(index)
    for bit in range(bits):
        result |= (index >> bit & 1) << (bits - 1 - bit)
    return result
