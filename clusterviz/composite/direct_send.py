"""Direct send: every rank owns one piece of the picture and gets that piece from everybody at once.

What: one round; rank r owns piece r of n. With m owners, m ranks spread evenly own a piece each, the others only send.
When: up to some tens of ranks, and sparse images at any number: no pixel moves twice, and a rank sends nothing to the
owner of a piece that its footprint does not touch, so sparse images move the least of all algorithms.
When not: hundreds of ranks with dense images: the number of messages grows with n².
Cost: 1 round, n(n − 1) messages, (n − 1)·P pixels; a rank sends and receives (1 − 1/n)·P. With m owners, m(n − 1)
messages; a rank sends at most P, an owner receives (n − 1)/m·P.
Limits: any number of ranks and pixels; with more ranks than pixels some own nothing. Several partial images a rank: by
theory yes, since an owner sorts all that it receives; the exchange carries one for each rank as yet.
Reference: W. M. Hsu, "Segmented ray casting for data parallel volume rendering"; U. Neumann, "Parallel volume-rendering
algorithm performance on mesh-connected multicomputers"; both Parallel Rendering Symposium, 1993.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clusterviz.composite.patch import Patch
from clusterviz.composite.schedule import Schedule, Stage, borders
from clusterviz.errors import InputError


def schedule(ranks: int, pixels: int, footprints: Sequence[Patch] = (), *, owners: int | None = None) -> Schedule:
    """All to all owners (by default, all ranks), in one stage.

    Raises
    ------
    InputError
        There are more owners than ranks, or none.
    """
    owners = choose_owners(ranks, owners)
    if ranks < 2:
        return Schedule(ranks, pixels, ())
    source, piece = np.arange(ranks, dtype=np.int64)[:, None], np.arange(owners, dtype=np.int64)
    cuts = borders(owners, pixels)
    return Schedule(ranks, pixels, (Stage.of_columns(source, piece * ranks // owners, cuts[piece], cuts[piece + 1]),))


def choose_owners(ranks: int, owners: int | None) -> int:
    """How many ranks own a piece: all, unless told otherwise.

    Raises
    ------
    InputError
        There are more owners than ranks, or none.
    """
    if owners is not None and not min(ranks, 1) <= owners <= ranks:
        raise InputError("wrong number of owners for direct send", found=owners, allowed=f"1 to {ranks}")
    return ranks if owners is None else owners
