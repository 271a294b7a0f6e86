"""Bricks in memory: voxels laid out so that one load brings many of a cell's corners (`field.py` says which)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import BrickBox
from clusterviz.render.cpu.slots import Slots, Taken
from clusterviz.render.storage import STORED_TYPE, Slot
from clusterviz.render.stored_brick import Ranges, Stored

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
        self._slots = Slots()
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

    def make_room(self, bricks: Collection[Index]) -> None:
        """Let further bricks lie side by side, if they come."""
        self._slots.make_room(sum(words_of(self._slot.at(index)) for index in bricks))

    def put(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Keep bricks beside those that are here; each is taken out, so that none is held twice for long."""
        self.make_room(bricks.keys())
        for index in list(bricks):
            brick, own = stored(index, bricks.pop(index)), self._slot.at(index)
            slot = self._slots.take(words_of(own))
            lay_out(brick.samples, own, slot.words)
            self._kept[index] = Kept(slot, brick.low, brick.high, brick.voxels, brick.bend)

    def stored(self, bricks: Iterable[Index]) -> Iterator[tuple[Index, Stored]]:
        """Bricks that are here, as every caster can take them; copies, since slots are taken by others later."""
        kind = STORED_TYPE[self._slot.kind]
        for index in bricks:
            kept = self._kept[index]
            samples = kept.slot.words[:-1].view(kind).reshape(*self._slot.at(index).samples_zyx, -1)[..., 0]
            yield index, Stored(samples.copy(), kept.low, kept.high, kept.voxels, kept.bend)

    def drop(self, bricks: Iterable[Index]) -> None:
        """Give up bricks."""
        for index in bricks:
            if kept := self._kept.pop(index, None):
                self._slots.give_back(kept.slot)

    def numbered(self, box: BrickBox, bricks: NDArray[np.int64]) -> tuple[NDArray[np.uint32], Numbers]:
        """Voxels, and by which of them bricks begin, of the box's shape: 0 for those that are not asked for.

        Where bricks are of several sizes, it is told of each of their units (`BrickLayout.units`).

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
        end = max(start + words.size for start, words in zip(starts.tolist(), slots, strict=True))
        kind, layout = np.uint32 if end <= NARROW else np.int64, self._slot.layout
        low, high = layout.unit_box(box.begin_zyx, box.end_zyx) if layout else (box.begin_zyx, box.end_zyx)
        numbers = np.zeros(tuple(np.subtract(high, low).tolist()), kind)
        if layout is None:
            numbers[tuple((bricks - box.begin_zyx).T)] = starts
            return slots[first], numbers
        for units, start, (row, layer) in zip(self._units(low, bricks), starts, self._pitches(bricks), strict=True):
            z, y, x = (layout.brick * np.arange(along.stop - along.start) for along in units)
            numbers[units] = start + (layer * z[:, None, None] + row * y[:, None] + x)
        return slots[first], numbers

    def pitches(self, box: BrickBox, bricks: NDArray[np.int64]) -> NDArray[np.int32]:
        """Voxels from row to row, and from layer to layer, of the units of bricks of several sizes.

        Returns
        -------
        pitches : int32 (*units of the box, 2); 0 for those that are not asked for
        """
        assert self._slot.layout, "bricks of one size have one pitch"
        low, high = self._slot.layout.unit_box(box.begin_zyx, box.end_zyx)
        found = np.zeros((*np.subtract(high, low), 2), np.int32)
        for units, pitch in zip(self._units(low, bricks), self._pitches(bricks), strict=True):
            found[units] = pitch
        return found

    def ranges(self, bricks: NDArray[np.int64]) -> Ranges:
        """Lowest and highest samples of the groups of the units of bricks, (m, *slot.unit.groups_zyx) each."""
        kept = [self._kept[z, y, x] for z, y, x in bricks.tolist()]
        return self._by_units([one.low for one in kept]), self._by_units([one.high for one in kept])

    def bends(self, bricks: NDArray[np.int64]) -> NDArray[np.float32]:
        """How bent the field is in the groups of the units of bricks, (m, 2, *slot.unit.groups_zyx): see `bends.py`."""
        found = [self._kept[z, y, x].bend for z, y, x in bricks.tolist()]
        return self._by_units([bend for bend in found if bend is not None])

    def _units(self, low: Index, bricks: NDArray[np.int64]) -> Iterator[tuple[slice, slice, slice]]:
        """The units of each brick, counted from one."""
        assert self._slot.layout, "bricks of one size are units themselves"
        for z, y, x in bricks.tolist():
            box = self._slot.layout.unit_box((z, y, x), (z + 1, y + 1, x + 1))
            a, b, c = (slice(begin - first, end - first) for begin, end, first in zip(*box, low, strict=True))
            yield a, b, c

    def _pitches(self, bricks: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
        """Voxels from row to row, and from layer to layer, of each brick."""
        for z, y, x in bricks.tolist():
            _, rows, row = self._slot.at((z, y, x)).samples_zyx
            yield row, row * rows

    def _by_units(self, groups: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """What is known of the groups of bricks, (..., *groups) each, unit by unit."""
        if self._slot.layout is None:
            return np.stack(groups)
        sides, found = self._slot.unit.groups_zyx, []
        for group in groups:
            *others, z, y, x = group.shape
            missing = [(0, -n % side) for n, side in zip((z, y, x), sides, strict=True)]
            padded = np.pad(group, [(0, 0)] * len(others) + missing, mode="edge")
            for axis, side in zip((-1, -2, -3), sides[::-1], strict=True):
                padded = np.stack(np.split(padded, padded.shape[axis] // side, axis))
            found.append(padded.reshape(-1, *padded.shape[3:]))
        return np.concatenate(found)


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
