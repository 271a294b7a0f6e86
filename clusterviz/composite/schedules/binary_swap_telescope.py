"""Telescoped binary swap: blocks of 2^d ranks swap separately, then each smaller block sends its ranges to a larger.

What: the ranks are cut into blocks of powers of two (13 = 8 + 4 + 1). Each block does a binary swap, then the smallest
sends its pieces to the next larger one, and so on, until the largest has the picture.
When: numbers of ranks that are no power of two: only the smallest block may send whole images.
When not: a power of two, where it is binary swap; sparse images.
Cost, n = Σ 2^d_i, d the largest d_i: d + 1 rounds, because sends between blocks overlap with swaps; Σ d_i·2^d_i
messages in swaps, and Σ 2^d_i over all blocks but the smallest between blocks; a rank sends at most P.
Limits: one partial image a rank, or several adjacent in depth.
Reference: K. Moreland, LDAV 2018, as for binary swap; K. Moreland et al., "An image compositing solution at scale", SC
2011.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from clusterviz.composite.schedules.binary_swap import parts, swap
from clusterviz.composite.schedules.schedule import Indices, Patches, Schedule, Stage, borders


def schedule(ranks: int, pixels: int, footprints: Patches = ()) -> Schedule:
    """Return the schedule: swaps in blocks, and transfers between blocks as soon as both are ready."""
    blocks = _blocks(ranks)
    rounds = ranks.bit_length() - 1 + (len(blocks) > 1)
    stages = []
    for round_ in range(rounds):
        swaps = [swap(block, round_, pixels) for block in blocks if len(block) >> round_ > 1]
        # A block of 2^round_ ranks has no more swaps; by now the smaller one has ended too.
        hand_overs = [
            _hand_over(smaller, larger, pixels) for larger, smaller in pairwise(blocks) if len(larger) >> round_ == 1
        ]
        stages.append(Stage.join([*swaps, *hand_overs]))
    return Schedule(ranks, pixels, tuple(stages))


def _blocks(ranks: int) -> list[Indices]:
    blocks, begin = [], 0
    for digit in reversed(range(ranks.bit_length())):
        if ranks >> digit & 1:
            blocks.append(np.arange(begin, begin + (1 << digit), dtype=np.int64))
            begin += 1 << digit
    return blocks


def _hand_over(smaller: Indices, larger: Indices, pixels: int) -> Stage:
    """Return the transfers to every rank of the larger block, from the rank of the smaller that holds its range."""
    index = np.arange(len(larger), dtype=np.int64)
    part, cuts = parts(index, len(larger).bit_length() - 1), borders(len(larger), pixels)
    return Stage.of_columns(smaller[index % len(smaller)], larger, cuts[part], cuts[part + 1])
