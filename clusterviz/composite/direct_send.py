"""Direct send: every rank owns one piece of the picture and gets that piece from everybody at once.

What: one round; rank r owns piece r of n.
When: up to some tens of ranks, and sparse images at any number: no pixel moves twice, and a rank sends nothing to the
owner of a piece that its footprint does not touch, so sparse images move the least of all algorithms.
When not: hundreds of ranks with dense images: the number of messages grows with n².
Cost: 1 round, n(n − 1) messages, (n − 1)·P pixels; a rank sends and receives (1 − 1/n)·P.
Limits: any number of ranks and pixels; with more ranks than pixels some own nothing.
Reference: W. M. Hsu, "Segmented ray casting for data parallel volume rendering"; U. Neumann, "Parallel volume-rendering
algorithm performance on mesh-connected multicomputers"; both Parallel Rendering Symposium, 1993.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.patch import Patch
from clusterviz.composite.schedule import Schedule, Stage


def schedule(ranks: int, pixels: int, footprints: Sequence[Patch] = ()) -> Schedule:
    """All to all, in one stage; built as a table, since n² transfers are many."""
    if ranks < 2:
        return Schedule(ranks, pixels, ())
    borders = np.array([index * pixels // ranks for index in range(ranks + 1)], np.int64)
    source, target = (axis.ravel() for axis in np.meshgrid(np.arange(ranks), np.arange(ranks), indexing="ij"))
    table = np.stack([source, target, borders[target], borders[target + 1]], axis=1)
    table = table[(source != target) & (table[:, 3] > table[:, 2])]
    table.setflags(write=False)
    return Schedule(ranks, pixels, (Stage(table),))
