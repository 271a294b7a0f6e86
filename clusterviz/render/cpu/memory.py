"""Bricks in memory: voxels laid out so that one load brings many of a cell's corners (`field.py` says which).

Large arrays get large pages where the system has them, so that rays, which come to another page every few voxels, need
not look up where it is; and voxels that lie in few arrays can be told by numbers of 32 bits.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable, Collection, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import BrickBox
from clusterviz.render.storage import STORED_TYPE, Slot
from clusterviz.render.stored_brick import Ranges, Stored

LEAST_CHUNK = 1 << 24  # bytes of an array; nobody has them before they are written


@dataclass(eq=False)
class _Chunk:
    """An array of slots.

    Attributes
    ----------
    words : uint32 (n,)
    free : where free parts begin and end, rising; no two of them touch
    touched : words that have been part of a slot so far, from the first on
    """

    words: NDArray[np.uint32]
    free: list[tuple[int, int]] = field(default_factory=list)
    touched: int = 0

    def take(self, words: int) -> int | None:
        """Where a slot of so many words begins, in the first free part that holds them; None: there is none."""
        for at, (begin, end) in enumerate(self.free):
            if end - begin >= words:
                self.free[at : at + 1] = [(begin + words, end)] if end - begin > words else []
                self.touched = max(self.touched, begin + words)
                return begin
        return None

    def give_back(self, begin: int, end: int) -> None:
        """Let a slot be free, together with the free parts beside it."""
        at = bisect(self.free, (begin, end))
        if at < len(self.free) and self.free[at][0] == end:
            end = self.free.pop(at)[1]
        if at > 0 and self.free[at - 1][1] == begin:
            at -= 1
            begin = self.free.pop(at)[0]
        self.free.insert(at, (begin, end))


@dataclass(frozen=True, eq=False)
class Taken:
    """A slot that is taken.

    Attributes
    ----------
    words : uint32 (words of the slot,)
    chunk : the array in which it is
    begin : the word with which it begins there
    """

    words: NDArray[np.uint32]
    chunk: _Chunk
    begin: int


class Slots:
    """Slots of any sizes that are taken and given back one by one; an array goes when all of its slots are free."""

    def __init__(self) -> None:
        self._chunks: list[_Chunk] = []

    @property
    def bytes(self) -> int:
        """Memory that slots have taken, those that have been given back included while their array stays."""
        return 4 * sum(chunk.touched for chunk in self._chunks)

    def make_room(self, words: int) -> None:
        """Let so many words be free, side by side if there are not enough."""
        missing = words - sum(end - begin for chunk in self._chunks for begin, end in chunk.free)
        if missing > 0:
            self._add(missing)

    def take(self, words: int) -> Taken:
        """A free slot of so many words; what is in it is anything."""
        for chunk in self._chunks:
            begin = chunk.take(words)
            if begin is not None:
                return Taken(chunk.words[begin : begin + words], chunk, begin)
        self._add(words)
        return self.take(words)

    def give_back(self, slot: Taken) -> None:
        """Let a slot be free again."""
        chunk = slot.chunk
        chunk.give_back(slot.begin, slot.begin + slot.words.size)
        if chunk.free == [(0, chunk.words.size)]:
            self._chunks.remove(chunk)

    def _add(self, words: int) -> None:
        """Another array, for so many words at least."""
        words = max(words, LEAST_CHUNK // 4)
        self._chunks.append(_Chunk(np.empty(words, np.uint32), [(0, words)]))


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
    bend : of its groups, see `stored_brick.py`; None where the step is fixed
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
        """Curvature of the field in groups of units of bricks, (m, 2, *slot.unit.groups_zyx)."""
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
