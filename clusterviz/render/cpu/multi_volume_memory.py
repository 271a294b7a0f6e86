"""Bricks of several volumes in memory: what each volume has in a brick is kept as a brick of that volume alone.

Volumes that a brick does not meet take no memory there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import BrickBox
from clusterviz.render.cpu.memory import Memory, Numbers
from clusterviz.render.multi_volume_bricks import Part, pack_parts, parts_of
from clusterviz.render.storage import Slot
from clusterviz.render.stored_brick import Ranges, Stored

Index = tuple[int, int, int]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class KeptMixed:
    """A brick, but for its voxels.

    Attributes
    ----------
    firsts : int32 (volumes, 4), the volume's cell (x, y, z) that is its first, and 1; zeros where it has nothing
    low, high : smallest and largest finite sample of each volume in its groups of cells
    voxels : samples that it was made of
    """

    firsts: NDArray[np.int32]
    low: NDArray[Any]
    high: NDArray[Any]
    voxels: int


@dataclass(frozen=True, eq=False)
class Numbered:
    """Where the bricks of a box begin in one volume.

    Attributes
    ----------
    voxels, numbers : as `Memory.numbered` gives them
    firsts : int32 (*box, 4), as of `KeptMixed`
    bricks : how many have anything of the volume
    """

    voxels: NDArray[np.uint32]
    numbers: Numbers
    firsts: NDArray[np.int32]
    bricks: int


class MixedMemory:
    """Bricks of several volumes by index; as `Memory` those of one.

    Parameters
    ----------
    slot : what a brick takes; its parts are those of the volumes
    """

    def __init__(self, slot: Slot) -> None:
        self._slot = slot
        self._volumes = [Memory(part) for part in slot.parts]
        self._kept: dict[Index, KeptMixed] = {}

    @property
    def bricks(self) -> set[Index]:
        """Those that are here."""
        return set(self._kept)

    @property
    def bytes(self) -> int:
        """Memory taken by voxels."""
        return sum(volume.bytes for volume in self._volumes)

    @property
    def voxels(self) -> int:
        """Samples of which the bricks were made."""
        return sum(kept.voxels for kept in self._kept.values())

    def put(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Keep bricks beside those that are here; each is taken out, so that none is held twice for long."""
        for volume in self._volumes:
            volume.make_room(bricks.keys())
        for index in list(bricks):
            brick = stored(index, bricks.pop(index))
            firsts = np.zeros((len(self._volumes), 4), np.int32)
            for number, part in enumerate(parts_of(brick.samples, self._slot)):
                if part is not None:
                    firsts[number] = *part.first_xyz, 1
                    own = Stored(part.samples, brick.low[number], brick.high[number], part.samples.size)
                    self._volumes[number].put({index: own}, lambda _, one: one)
            self._kept[index] = KeptMixed(firsts, brick.low, brick.high, brick.voxels)

    def stored(self, bricks: Iterable[Index]) -> Iterator[tuple[Index, Stored]]:
        """Bricks that are here, as every caster can take them."""
        for index in bricks:
            kept, parts = self._kept[index], []
            for volume, (*first, there) in zip(self._volumes, kept.firsts.tolist(), strict=True):
                own = [one.samples for _, one in volume.stored([index])] if there else []
                parts.append(Part(own[0], tuple(first)) if own else None)
            yield index, Stored(pack_parts(parts, self._slot), kept.low, kept.high, kept.voxels)

    def drop(self, bricks: Iterable[Index]) -> None:
        """Give up bricks."""
        for index in bricks:
            self._kept.pop(index, None)
            for volume in self._volumes:
                volume.drop([index])

    def numbered(self, box: BrickBox, bricks: NDArray[np.int64]) -> list[Numbered]:
        """Where bricks begin in each volume; numbers of one type.

        Parameters
        ----------
        bricks : int64 (m, 3), indices (z, y, x) in the box

        Raises
        ------
        KeyError
            One of them is not here.
        """
        each = [self._numbered_in(number, box, bricks) for number in range(len(self._volumes))]
        if all(one.numbers.itemsize == 4 for one in each):
            return each
        return [replace(one, numbers=one.numbers.astype(np.int64)) for one in each]

    def ranges(self, bricks: NDArray[np.int64]) -> Ranges:
        """Lowest and highest samples of the groups of bricks, (m, volumes, *slot.groups_zyx) each."""
        kept = [self._kept[z, y, x] for z, y, x in bricks.tolist()]
        return np.stack([one.low for one in kept]), np.stack([one.high for one in kept])

    def _numbered_in(self, number: int, box: BrickBox, bricks: NDArray[np.int64]) -> Numbered:
        own = np.array([self._kept[z, y, x].firsts[number] for z, y, x in bricks.tolist()])
        firsts = np.zeros((*box.shape_zyx, 4), np.int32)
        firsts[tuple((bricks - box.begin_zyx).T)] = own
        there = bricks[own[:, 3] > 0]
        if len(there) == 0:
            # Nobody reads them.
            return Numbered(np.zeros(1, np.uint32), np.zeros(box.shape_zyx, np.uint32), firsts, 0)
        return Numbered(*self._volumes[number].numbered(box, there), firsts, len(there))
