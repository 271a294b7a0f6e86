"""Bricks in memory: voxels laid out so that one load brings many of a cell's corners (`field.py` says which)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import BrickBox
from clusterviz.render.emptiness import Ranges
from clusterviz.render.storage import STORED_TYPE, Slot
from clusterviz.render.stored import Stored
from clusterviz.render.vectors.slots import Slots, Taken

Index = tuple[int, int, int]
T = TypeVar("T")
VOXEL_BYTES = 4
NARROW = 1 << 32  # voxels whose numbers have 32 bits
Numbers = NDArray[np.uint32] | NDArray[np.int64]
BESIDE = {"u8": ((0, 0), (0, 1), (1, 0), (1, 1)), "u16": ((0, 0), (0, 1)), "f32": ((0, 0),)}
"""By stored type: the voxels that lie beside each one, (z, y) further on."""


@dataclass(frozen=True, eq=False)
class Kept:
    """A brick.

    Attributes
    ----------
    slot : one word a voxel, and one behind them that loads may touch
    low, high : smallest and largest finite sample of its groups of cells
    voxels : samples that it was made of
    bend : of its groups, see `bends.py`; None where slabs are not stretched
    """

    slot: Taken
    low: NDArray[Any]
    high: NDArray[Any]
    voxels: int
    bend: NDArray[np.float32] | None = None


class Memory:
    """Bricks by index.

    Parameters
    ----------
    slot : what a brick takes
    """

    def __init__(self, slot: Slot) -> None:
        self._slot = slot
        self._slots = Slots(words_of(slot))
        self._kept: dict[Index, Kept] = {}

    @property
    def bricks(self) -> set[Index]:
        """Those that are here."""
        return set(self._kept)

    @property
    def bytes(self) -> int:
        """Memory taken by voxels."""
        return self._slots.bytes

    @property
    def voxels(self) -> int:
        """Samples of which the bricks were made."""
        return sum(kept.voxels for kept in self._kept.values())

    def make_room(self, bricks: int) -> None:
        """Let so many further bricks lie side by side, if they come."""
        self._slots.make_room(bricks)

    def put(self, bricks: MutableMapping[Index, T], stored: Callable[[T], Stored]) -> None:
        """Keep bricks beside those that are here; each is taken out, so that none is held twice for long."""
        self.make_room(len(bricks))
        for index in list(bricks):
            brick = stored(bricks.pop(index))
            slot = self._slots.take()
            lay_out(brick.samples, self._slot, slot.words)
            self._kept[index] = Kept(slot, brick.low, brick.high, brick.voxels, brick.bend)

    def stored(self, bricks: Iterable[Index]) -> Iterator[tuple[Index, Stored]]:
        """Bricks that are here, as every caster can take them; copies, since slots are taken by others later."""
        shape, kind = (*self._slot.samples_zyx, -1), STORED_TYPE[self._slot.kind]
        for index in bricks:
            kept = self._kept[index]
            samples = kept.slot.words[:-1].view(kind).reshape(shape)[..., 0]
            yield index, Stored(samples.copy(), kept.low, kept.high, kept.voxels, kept.bend)

    def drop(self, bricks: Iterable[Index]) -> None:
        """Give up bricks."""
        for index in bricks:
            if kept := self._kept.pop(index, None):
                self._slots.give_back(kept.slot)

    def numbered(self, box: BrickBox, bricks: NDArray[np.int64]) -> tuple[NDArray[np.uint32], Numbers]:
        """Voxels, and by which of them bricks begin, of the box's shape: 0 for those that are not asked for.

        Parameters
        ----------
        bricks : int64 (m, 3), indices (z, y, x) in the box; one at least

        Returns
        -------
        voxels : of one of them; those of the others lie behind, and all are numbered from here
        numbers : uint32; int64 where 32 bits are too few

        Raises
        ------
        KeyError
            One of them is not here.
        """
        slots = [self._kept[z, y, x].slot.words for z, y, x in bricks.tolist()]
        starts = np.array([words.__array_interface__["data"][0] for words in slots]) // VOXEL_BYTES
        first = int(starts.argmin())
        starts -= starts[first]
        numbers = np.zeros(box.shape_zyx, np.uint32 if starts.max() + len(slots[0]) <= NARROW else np.int64)
        numbers[tuple((bricks - box.begin_zyx).T)] = starts
        return slots[first], numbers

    def ranges(self, bricks: NDArray[np.int64]) -> Ranges:
        """Lowest and highest samples of the groups of bricks, (m, *slot.groups_zyx) each."""
        kept = [self._kept[z, y, x] for z, y, x in bricks.tolist()]
        return np.stack([one.low for one in kept]), np.stack([one.high for one in kept])

    def bends(self, bricks: NDArray[np.int64]) -> NDArray[np.float32]:
        """How bent the field is in the groups of bricks, (m, 2, *slot.groups_zyx): see `bends.py`."""
        found = [self._kept[z, y, x].bend for z, y, x in bricks.tolist()]
        return np.stack([bend for bend in found if bend is not None])


def words_of(slot: Slot) -> int:
    """32-bit words that a brick takes: one a voxel, and one behind them that loads may touch."""
    return int(np.prod(slot.samples_zyx)) + 1


def lay_out(stored: NDArray[Any], slot: Slot, words: NDArray[np.uint32]) -> None:
    """Write one brick's words; the last samples of a smaller one are repeated."""
    beside = BESIDE[slot.kind]
    missing = [(0, n + 1 - have) for n, have in zip(slot.samples_zyx, stored.shape, strict=True)]
    padded = np.pad(stored, missing, mode="edge")
    z, y, x = slot.samples_zyx
    words[-1] = 0
    parts = words[:-1].view(stored.dtype).reshape(z, y, x, len(beside))
    for part, (up, down) in enumerate(beside):
        parts[..., part] = padded[up : up + z, down : down + y, :x]
