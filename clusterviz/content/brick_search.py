"""Entries whose primitives or tetrahedra lie in bricks of a domain, which ranks share the search for.

Each rank finds of its share in which bricks they are, and sends what it found of brick i to rank i mod n, which counts
and keeps it. A rank that reads bricks asks there.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence, Set
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import Channel, agree, all_to_all
from clusterviz.data.primitives import BrickBoxes, BrickMembers, DrawnPrimitives, brick_keys, members_of_keys
from clusterviz.data.source import Index
from clusterviz.plan.domain import BrickGrid, Placed

Floats = NDArray[np.float64]
Numbers = NDArray[np.uint32]
Scalar = TypeVar("Scalar", bound=np.generic)
OwnLayer = TypeVar("OwnLayer")
Held = TypeVar("Held")
TAG = 73


class PlacedEntry(ABC, Generic[OwnLayer, Held]):
    """Opened entry of a scene; construction, `layer` and `read` are collective.

    After a rank has read its bricks it forgets the file, which it reads again if bricks are missing later.

    It has facts, `info`. The section is that of the scene file, the key is for errors.
    """

    info: Any

    def __init__(self, section: Any, key: str, channel: Channel) -> None:
        self._section, self._key, self._channel = section, key, channel
        self._of_bricks: dict[Any, NDArray[Any]] = {}

    def read(self, layer: Any, grid: BrickGrid, wanted: Set[Index]) -> dict[Index, Held]:
        """Return what the entry has in some bricks of a plan, but those without anything, and forget the others."""
        with agree(self._channel, 0, "load"):
            some = sorted(index for index in wanted if layer.in_bricks[0][index])
        most = self._channel.maximum(len(some))
        found = self._received(layer, grid, some, most) if most else {}
        self._forget()
        return found

    def _counted(self, section: Any, grid: BrickGrid) -> NDArray[np.int64]:
        """Return members and positions of each brick, int64 (2, bz, by, bx)."""
        return self._in_all_bricks("counts", section, grid, lambda drawn, members: members.counted(drawn))

    def _in_all_bricks(
        self,
        name: str,
        section: Any,
        grid: BrickGrid,
        measure: Callable[[DrawnPrimitives, BrickMembers], NDArray[Any]],
    ) -> NDArray[Any]:
        """Return what each rank measures of the bricks that it keeps, (k, bz, by, bx); collective once for a grid."""
        key = name, key_of(section, grid)
        if key not in self._of_bricks:
            drawn, members = self._kept_members(section, grid)
            with agree(self._channel, 0, "plan"):
                mine = measure(drawn, members)
            self._of_bricks[key] = of_all_bricks(mine, grid, self._channel)
        return self._of_bricks[key]

    @abstractmethod
    def _kept_members(self, section: Any, grid: BrickGrid) -> tuple[DrawnPrimitives, BrickMembers]:
        """Return the primitives of the bricks r, r + n, r + 2 n, … on rank r of n, and which each has; collective."""

    @abstractmethod
    def _received(self, layer: OwnLayer, grid: BrickGrid, some: Sequence[Index], most: int) -> dict[Index, Held]:
        """Return bricks with members from the ranks that keep them, `most` on any rank; collective."""

    @abstractmethod
    def _forget(self) -> None:
        """Free what was read."""


def asked_for(bricks: Sequence[int], channel: Channel) -> tuple[list[NDArray[np.int64]], list[NDArray[np.int64]]]:
    """Return the bricks that this rank asks each rank for, and that each asks of it; collective."""
    with agree(channel, 0, "load"):
        flat = np.array(bricks, np.int64)
        asked = [flat[flat % channel.size == rank] for rank in range(channel.size)]
    return asked, all_to_all(channel, asked, TAG)


def flat_of(bricks: Sequence[Index], grid: BrickGrid) -> list[int]:
    """Return the numbers of bricks, which count x first."""
    return [int(np.ravel_multi_index(index, grid.layout.counts_zyx)) for index in bricks]


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
