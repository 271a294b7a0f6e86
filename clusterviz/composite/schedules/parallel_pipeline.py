"""Parallel pipeline: n pieces travel at once, each from neighbour to neighbour towards its owner.

What: rank f owns piece f of n. The piece starts at both neighbours of its owner, runs outwards from rank to rank, each
merging its own pixels, and from either end of the line it jumps back to the owner (the wrap shortcut, without which it
would travel the ring with two accumulators). So only neighbours in depth are ever merged, and a rank sends and receives
at most two pieces in a round, mostly to and from the ranks beside it.
When: rings and meshes of machines whose links to neighbours are the good ones; very large pictures.
When not: many ranks on a switched network: n − 1 rounds, each of which waits for the one before.
Cost: n − 1 rounds, n(n − 1) messages, (n − 1)·P pixels; a rank sends and receives (1 − 1/n)·P.
Limits: any number of ranks and pixels.
One partial image a rank, or several side by side in depth: the line is the order in depth.
Reference: T.-Y. Lee, C. S. Raghavendra, J. B. Nicholas, "Image composition schemes for sort-last polygon rendering on
2D mesh multicomputers", IEEE Transactions on Visualization and Computer Graphics 2(3), 1996. There all pieces run one
way, and inner ranks receive a whole P; running both ways evens that out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.fragment import Patch
from clusterviz.composite.schedules.schedule import Indices, Schedule, Stage, borders

SEVERAL_IMAGES = False


def schedule(ranks: int, pixels: int, footprints: Sequence[Patch] = ()) -> Schedule:
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
