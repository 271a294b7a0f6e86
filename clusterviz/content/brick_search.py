"""Search for the primitives that come near each brick of a domain, shared between all ranks.

Each rank opens the file of an entry, and finds of an equal share of the primitives in which bricks they are. It sends
the numbers of the primitives in brick i to rank i mod n, which counts and keeps them. A rank that reads bricks asks
there for the numbers, and takes the primitives from the file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree, all_to_all
from clusterviz.data.primitives import BrickBoxes, BrickMembers, DrawnPrimitives, brick_keys, members_of_keys
from clusterviz.plan.domain import BrickGrid, Placed

Floats = NDArray[np.float64]
Numbers = NDArray[np.uint32]
Scalar = TypeVar("Scalar", bound=np.generic)
TAG = 73


class BrickSearch:
    """Search for the primitives of one entry of a scene.

    Parameters
    ----------
    open_file : reads the primitives
    channel : to the other ranks

    Attributes
    ----------
    drawn : the primitives, until they are forgotten
    """

    def __init__(self, open_file: Callable[[], DrawnPrimitives], channel: Channel) -> None:
        self._open, self._channel = open_file, channel
        self.drawn: DrawnPrimitives | None = None
        self._share: NDArray[np.int64] | None = None
        self._counts: dict[Any, NDArray[np.int64]] = {}
        self._members: tuple[Any, BrickMembers | None] = None, None

    def forget(self) -> None:
        """Free the primitives; the members of bricks are kept."""
        self.drawn = self._share = None

    def opened(self) -> DrawnPrimitives:
        """Return the primitives, which are read if they were forgotten."""
        if self.drawn is None:
            self.drawn = self._open()
        return self.drawn

    def share(self) -> NDArray[np.int64]:
        """Return the numbers of the primitives that this rank looks at."""
        if self._share is None:
            self._share = self.opened().share(self._channel.rank, self._channel.size)
        return self._share

    def counted(self, section: Placed, grid: BrickGrid) -> NDArray[np.int64]:
        """Return the primitives and positions of each brick; the first call for a grid is collective."""
        key = key_of(section, grid)
        if key not in self._counts:
            members = self.members(section, grid)
            with agree(self._channel, 0, "plan"):
                mine = members.counted(self.opened())
            self._counts[key] = of_all_bricks(mine, grid, self._channel)
        return self._counts[key]

    def members(self, section: Placed, grid: BrickGrid) -> BrickMembers:
        """Return the members of the bricks r, r + n, r + 2 n, … on rank r of n; those of the last grid are kept.

        Collective if the grid is not the last.
        """
        key = key_of(section, grid)
        last, members = self._members
        if members is None or last != key:
            self._members = None, None
            with agree(self._channel, 0, "plan"):
                sent = sent_keys(self.opened(), self.share(), section, grid, self._channel.size)
            members = received_members(all_to_all(self._channel, sent, TAG), grid, self._channel)
            self._members = key, members
        return members

    def gathered(self, section: Placed, grid: BrickGrid, bricks: Sequence[int]) -> dict[int, Numbers]:
        """Return the numbers of the primitives of some bricks from the ranks that keep them; collective."""
        members, counts = self.members(section, grid), self.counted(section, grid)[0].ravel()
        ranks = self._channel.size
        with agree(self._channel, 0, "load"):
            asked = [np.array([brick for brick in bricks if brick % ranks == rank], np.int64) for rank in range(ranks)]
        requests = all_to_all(self._channel, asked, TAG)
        with agree(self._channel, 0, "load"):
            empty = np.empty(0, np.uint32)
            sent = [np.concatenate([empty, *(members.of(one // ranks) for one in each.tolist())]) for each in requests]
        received = all_to_all(self._channel, sent, TAG, [int(counts[each].sum()) for each in asked])
        found: dict[int, Numbers] = {}
        for each, numbers in zip(asked, received, strict=True):
            found |= zip(each.tolist(), np.split(numbers, np.cumsum(counts[each])[:-1]), strict=False)
        return found


def brick_boxes(section: Placed, grid: BrickGrid, ranks: int) -> BrickBoxes:
    """Return the bricks with the entry's place in them."""
    radius, layout = getattr(section, "radius", 1.0), grid.layout
    factor = (radius if isinstance(radius, float) else 1.0) / grid.domain.spacing
    return BrickBoxes(grid.index_from_file(section), factor, layout.brick, layout.counts_zyx, grid.reach, ranks)


def sent_keys(
    drawn: DrawnPrimitives, share: NDArray[np.int64], section: Placed, grid: BrickGrid, ranks: int
) -> list[NDArray[np.uint64]]:
    """Return the keys (`brick_keys`) of some primitives for the rank that keeps each brick."""
    keys = brick_keys(drawn, share, brick_boxes(section, grid, ranks))
    begins = np.arange(1, ranks, dtype=np.uint64) * np.uint64(_kept(grid, ranks)) << np.uint64(32)
    return np.split(keys, np.searchsorted(keys, begins))


def received_members(received: Sequence[NDArray[np.uint64]], grid: BrickGrid, channel: Channel) -> BrickMembers:
    """Return the members of the bricks that this rank keeps, from the keys that the ranks sent; collective."""
    with agree(channel, 0, "plan"):
        keys = np.concatenate(received) if len(received) > 1 else received[0]
        if len(received) > 1:
            keys.sort()
        bricks = _kept(grid, channel.size)
        return members_of_keys(keys, channel.rank * bricks, bricks)


def of_all_bricks(mine: NDArray[Scalar], grid: BrickGrid, channel: Channel) -> NDArray[Scalar]:
    """Return values of the bricks that each rank keeps (k, bricks) for all bricks (k, bz, by, bx); collective."""
    counts_zyx, values = grid.layout.counts_zyx, len(mine)
    every = np.stack(channel.allgather(mine), axis=2).reshape(values, -1)
    return every[:, : int(np.prod(counts_zyx))].reshape(values, *counts_zyx)


def _kept(grid: BrickGrid, ranks: int) -> int:
    """Return the number of bricks that each rank keeps."""
    return -(-int(np.prod(grid.layout.counts_zyx)) // ranks)


def key_of(section: Placed, grid: BrickGrid) -> tuple[object, ...]:
    """Return what decides in which bricks primitives are."""
    return grid.domain, grid.layout.brick, grid.reach, getattr(section, "radius", None), section.transform
