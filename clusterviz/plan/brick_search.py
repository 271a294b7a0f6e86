"""Search for the primitives that come near each brick of a domain, shared between all ranks.

Each rank opens the file of an entry, and finds of an equal share of the primitives in which bricks they are. It sends
the numbers of the primitives in brick i to rank i mod n, which counts and keeps them. A rank that reads bricks asks
there for the numbers, and takes the primitives from the file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree, all_to_all
from clusterviz.data.bricks import BrickLayout
from clusterviz.data.primitives import BrickBoxes, BrickMembers, DrawnPrimitives, brick_keys, members_of_keys
from clusterviz.plan.domain import Domain
from clusterviz.scene.geometry import GeometrySection
from clusterviz.scene.grids import GridSection

Floats = NDArray[np.float64]
Numbers = NDArray[np.uint32]
Placed = GeometrySection | GridSection
Scalar = TypeVar("Scalar", bound=np.generic)
TAG = 73


@dataclass(frozen=True, eq=False)
class BrickGrid:
    """Bricks in which primitives are looked for.

    Attributes
    ----------
    domain, layout : of a plan
    reach : cells beyond its own in which a brick has primitives
    """

    domain: Domain
    layout: BrickLayout
    reach: int

    def index_from_file(self, section: Placed) -> Floats:
        """Return the map from an entry's coordinates to cells of the domain, float64 (3, 4)."""
        matrix = world_from_file(section)[:3].copy()
        matrix[:, 3] -= self.domain.origin
        return matrix / self.domain.spacing


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
        key = _key_of(section, grid)
        if key not in self._counts:
            members = self.members(section, grid)
            with agree(self._channel, 0, "plan"):
                mine = members.counted(self.opened())
            self._counts[key] = self.of_all_bricks(mine, grid)
        return self._counts[key]

    def of_all_bricks(self, mine: NDArray[Scalar], grid: BrickGrid) -> NDArray[Scalar]:
        """Return values of the bricks that each rank keeps (k, bricks) for all bricks (k, bz, by, bx); collective."""
        counts_zyx, values = grid.layout.counts_zyx, len(mine)
        every = np.stack(self._channel.allgather(mine), axis=2).reshape(values, -1)
        return every[:, : int(np.prod(counts_zyx))].reshape(values, *counts_zyx)

    def members(self, section: Placed, grid: BrickGrid) -> BrickMembers:
        """Return the members of the bricks r, r + n, r + 2 n, … on rank r of n; those of the last grid are kept.

        Collective if the grid is not the last.
        """
        key, boxes, ranks = _key_of(section, grid), self.boxes(section, grid), self._channel.size
        last, members = self._members
        if members is None or last != key:
            self._members, bricks = (None, None), -(-int(np.prod(boxes.counts_zyx)) // ranks)
            with agree(self._channel, 0, "plan"):
                # The bricks of each rank, one rank after the other.
                keys = brick_keys(self.opened(), self.share(), boxes)
                begins = np.arange(1, ranks, dtype=np.uint64) * np.uint64(bricks) << np.uint64(32)
                sent = np.split(keys, np.searchsorted(keys, begins))
            received = all_to_all(self._channel, sent, TAG)
            with agree(self._channel, 0, "plan"):
                if ranks > 1:
                    keys = np.concatenate(received)
                    keys.sort()
                members = members_of_keys(keys, self._channel.rank * bricks, bricks)
            self._members = key, members
        return members

    def boxes(self, section: Placed, grid: BrickGrid) -> BrickBoxes:
        """Return the bricks with the entry's place in them."""
        radius, layout = getattr(section, "radius", 1.0), grid.layout
        factor = (radius if isinstance(radius, float) else 1.0) / grid.domain.spacing
        matrix, ranks = grid.index_from_file(section), self._channel.size
        return BrickBoxes(matrix, factor, layout.brick, layout.counts_zyx, grid.reach, ranks)

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


def _key_of(section: Placed, grid: BrickGrid) -> tuple[object, ...]:
    return grid.domain, grid.layout.brick, grid.reach, getattr(section, "radius", None), section.transform


def world_from_file(section: Placed) -> Floats:
    """Return the entry's transform, float64 (4, 4)."""
    return np.array(section.transform or np.eye(4), np.float64)
