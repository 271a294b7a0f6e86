"""Parallel pipeline: n pieces travel at once, each from neighbour to neighbour towards its owner.

What: rank f owns piece f of n. The piece starts at both neighbours of its owner and moves outwards from rank to rank,
each merging its own pixels. From the ends of the line it is sent back to the owner. A rank sends and receives at most
two pieces in a round.
When: rings and meshes of machines with good links to neighbours; very large pictures.
When not: many ranks on a switched network: each of n − 1 rounds waits for the one before.
Cost: n − 1 rounds, n(n − 1) messages; a rank sends and receives (1 − 1/n)·P.
Limits: one partial image a rank, or several adjacent in depth.
Reference: T.-Y. Lee et al., "Image composition schemes for sort-last polygon rendering on 2D mesh multicomputers", IEEE
TVCG 2(3), 1996. There all pieces move one way, and inner ranks receive P.
"""

from __future__ import annotations

import numpy as np

from clusterviz.composite.schedules.schedule import Indices, Patches, Schedule, Stage, borders


def schedule(ranks: int, pixels: int, footprints: Patches = ()) -> Schedule:
    """Return the schedule: in round t, the ranks at distance t + 1 from an owner send its piece on."""
    cuts = borders(ranks, pixels)
    return Schedule(ranks, pixels, tuple(_round(number, ranks, cuts) for number in range(ranks - 1)))


def _round(number: int, ranks: int, cuts: Indices) -> Stage:
    """Return one round: pieces travel outwards; from rank 0 and the last rank they are sent to their owners."""
    source = np.arange(ranks, dtype=np.int64)
    before, behind = source[: ranks - 1 - number], source[number + 1 :]
    # Rank r in front holds the piece of r + number + 1, and so on, mirrored, behind.
    towards_front = np.where(before == 0, before + number + 1, before - 1)
    towards_back = np.where(behind == ranks - 1, behind - number - 1, behind + 1)
    piece = np.concatenate([before + number + 1, behind - number - 1])
    target = np.concatenate([towards_front, towards_back])
    return Stage.of_columns(np.concatenate([before, behind]), target, cuts[piece], cuts[piece + 1])
