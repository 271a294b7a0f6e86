"""Bricks in memory, one word a voxel, so that a cell's eight corners take few loads (shaders/cells_*.glsl).

A word holds a voxel and, if there is room, those beside it along y and z. With several volumes a brick begins with a
header, as in OpenGL's slots (`content_bricks.py`), but takes no memory for volumes that it does not meet, and less for
those of which it holds a coarser level. Bricks lie in few large arrays, which the system backs by large pages where it
can, so that numbers of 32 bits mostly address all words.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import BrickBox
from clusterviz.plan.geometry import Members
from clusterviz.render.content_bricks import header_of, read_header, write_header
from clusterviz.render.storage import STORED_TYPE, Slot
from clusterviz.render.stored_brick import Part, Ranges, Stored
from clusterviz.spmd.intrinsics import IDLE_WORD

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
    """Slots of any sizes that are taken and given back one by one; an array goes when all of its slots are free.

    Parameters
    ----------
    around : words before the first slot and behind the last that may be read
    """

    def __init__(self, around: int = 0) -> None:
        self._chunks: list[_Chunk] = []
        self._around = around

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
        space = np.empty(words + 2 * self._around, np.uint32)
        self._chunks.append(_Chunk(space[self._around : self._around + words], [(0, words)]))


Index = tuple[int, int, int]
T = TypeVar("T")
NARROW = 1 << 31  # words that numbers of 32 bits address
BESIDE = {"u8": ((0, 0), (0, 1), (1, 0), (1, 1)), "u16": ((0, 0), (0, 1)), "f32": ((0, 0),)}
"""By stored type: the voxels (z, y) beside each one that share its word."""


@dataclass(frozen=True, eq=False)
class Kept:
    """Brick in memory.

    Attributes
    ----------
    slot : memory of its voxels
    low, high, voxels, bend, members : as in `Stored`
    """

    slot: Taken
    low: NDArray[Any]
    high: NDArray[Any]
    voxels: int
    bend: NDArray[np.float32] | None = None
    members: tuple[Members | None, ...] = ()


@dataclass(frozen=True, eq=False)
class BrickTable:
    """Addresses of the bricks of a box, or of their units if bricks have several sizes (`BrickLayout.units`).

    Attributes
    ----------
    voxels : words of the brick with the lowest address
    offsets : int32 (z, y, x), words from there, or rows of `bases`; -1 for bricks that are not drawn
    bases : uint64 (n,), addresses of each brick, and of its volumes if there are several; None if 32 bits suffice
    pitches : int32 (z, y, x, 4), words in a row, in a slice, and before the unit's first cell; None if bricks have one
        size
    bytes : of the voxels
    """

    voxels: NDArray[np.uint32]
    offsets: NDArray[np.int32]
    bases: NDArray[np.uint64] | None
    pitches: NDArray[np.int32] | None
    bytes: int


class Memory:
    """Bricks by index.

    Parameters
    ----------
    slot : layout of a brick; with several volumes its parts are those of the volumes
    """

    def __init__(self, slot: Slot) -> None:
        self._slot = slot
        self.release()

    def release(self) -> None:
        """Give up all bricks."""
        # A cubic spline reads three voxels beyond, along every axis; of lanes that are idle, beyond any header.
        self._slots = Slots(4 * max(sum(pitch_of(part)) for part in self._slot.parts or (self._slot,)) + IDLE_WORD)
        self._kept: dict[Index, Kept] = {}

    @property
    def bricks(self) -> set[Index]:
        """Indices of the bricks."""
        return set(self._kept)

    @property
    def bytes(self) -> int:
        """Memory taken by voxels."""
        return self._slots.bytes

    @property
    def voxels(self) -> int:
        """Number of samples of which the bricks were made."""
        return sum(kept.voxels for kept in self._kept.values())

    def reserve(self, bricks: int) -> None:
        """Do nothing: arrays are allocated as slots are taken, and do not move."""

    def put(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Add bricks; each is removed from the mapping, so that none is held twice for long."""
        if not any(part.has_levels for part in self._slot.parts):
            self._slots.make_room(sum(words_of(self._slot.at(index)) for index in bricks))
        for index in list(bricks):
            brick, own = stored(index, bricks.pop(index)), self._slot.at(index)
            slot = self._slots.take(_words_of_parts(brick.parts, own) if own.mixed else words_of(own))
            if own.mixed:
                _lay_out_parts(brick.parts, own, slot.words)
            else:
                lay_out(brick.parts[0].samples, own, slot.words)  # type: ignore[union-attr]
            self._kept[index] = Kept(slot, brick.low, brick.high, brick.voxels, brick.bend, brick.members)

    def stored(self, bricks: Iterable[Index]) -> Iterator[tuple[Index, Stored]]:
        """Yield bricks as every ray caster can store them; copies, since slots are used again."""
        for index in bricks:
            kept, own = self._kept[index], self._slot.at(index)
            parts = _parts_in(kept.slot.words, own) if own.mixed else [Part(_samples(kept.slot.words, own).copy())]
            yield index, Stored(parts, kept.low, kept.high, kept.voxels, kept.bend, kept.members)

    def drop(self, bricks: Iterable[Index]) -> None:
        """Drop bricks."""
        for index in bricks:
            if kept := self._kept.pop(index, None):
                self._slots.give_back(kept.slot)

    def table(self, box: BrickBox, bricks: NDArray[np.int64]) -> BrickTable:
        """Return the addresses of the bricks of a box.

        Parameters
        ----------
        bricks : int64 (m, 3), indices (z, y, x) in the box; one at least

        Raises
        ------
        KeyError
            One of them is not in memory.
        """
        layout, kept = self._slot.layout, [self._kept[z, y, x] for z, y, x in bricks.tolist()]
        starts = np.array([_address(one.slot.words) for one in kept], np.int64)
        first = int(starts.argmin())
        numbers, bases = (starts - starts[first]) // 4, None
        if numbers.max() + max(one.slot.words.size for one in kept) > NARROW:
            bases = np.array([base for one in kept for base in self._bases(one)], np.uint64)
            numbers = np.arange(len(kept)) * (1 + len(self._slot.parts))
        size = sum(one.slot.words.nbytes for one in kept)
        low, high = layout.unit_box(box.begin_zyx, box.end_zyx) if layout else (box.begin_zyx, box.end_zyx)
        offsets = np.full(np.subtract(high, low), -1, np.int32)
        if layout is None:
            offsets[tuple((bricks - box.begin_zyx).T)] = numbers
            return BrickTable(kept[first].slot.words, offsets, bases, None, size)
        pitches = np.zeros((*offsets.shape, 4), np.int32)
        for (z, y, x), number in zip(bricks.tolist(), numbers.tolist(), strict=True):
            begin, end = layout.unit_box((z, y, x), (z + 1, y + 1, x + 1))
            units = tuple(slice(a - c, b - c) for a, b, c in zip(begin, end, low, strict=True))
            row, slice_ = pitch_of(self._slot.at((z, y, x)))
            at = layout.brick * np.indices([b - a for a, b in zip(begin, end, strict=True)])
            offsets[units], pitches[units][..., :2] = number, (row, slice_)
            pitches[units][..., 2] = slice_ * at[0] + row * at[1] + at[2] + self._slot.margin * (1 + row + slice_)
        return BrickTable(kept[first].slot.words, offsets, bases, pitches, size)

    def _bases(self, kept: Kept) -> list[int]:
        """Return the address of a brick and, with several volumes, those of its parts; 0 for those that it has not."""
        base = _address(kept.slot.words)
        begins = header_of(kept.slot.words, self._slot)[:, 0].tolist() if self._slot.parts else []
        return [base, *(base + 4 * begin if begin >= 0 else 0 for begin in begins)]

    def members(self, bricks: NDArray[np.int64]) -> list[tuple[Members | None, ...]]:
        """Return what bricks (m, 3) hold of each layer."""
        return [self._kept[z, y, x].members for z, y, x in bricks.tolist()]

    def ranges(self, bricks: NDArray[np.int64]) -> Ranges:
        """Return the lowest and highest samples of the groups of the units of bricks.

        Returns
        -------
        low, high : (m, 1, *slot.unit.groups_zyx)
        """
        kept = [self._kept[z, y, x] for z, y, x in bricks.tolist()]
        return self._by_units([one.low for one in kept]), self._by_units([one.high for one in kept])

    def ranges_of_each(self, bricks: NDArray[np.int64]) -> list[Ranges]:
        """Return the extremes of the groups of each brick of several volumes."""
        kept = [self._kept[z, y, x] for z, y, x in bricks.tolist()]
        return [(one.low, one.high) for one in kept]

    def bends(self, bricks: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the curvature of the field in groups of units of bricks, (m, 2, *slot.unit.groups_zyx)."""
        found = [self._kept[z, y, x].bend for z, y, x in bricks.tolist()]
        return self._by_units([bend for bend in found if bend is not None])

    def _by_units(self, groups: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """Return what is known of the groups of bricks, (..., *groups) each, unit by unit."""
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
    """Return the words of a brick at most: one a voxel of each volume, and one behind them that loads may touch."""
    if slot.mixed:
        return max(1, slot.header_words * len(slot.parts) + sum(words_of(part) for part in slot.parts))
    return int(np.prod(slot.samples_zyx)) + 1


def _words_of_parts(parts: Sequence[Part | None], slot: Slot) -> int:
    """Return the words of a brick with samples of some volumes."""
    words = [words_of(part.slot(own)) for part, own in zip(parts, slot.parts, strict=True) if part is not None]
    return max(1, slot.header_words * len(slot.parts) + sum(words))


def pitch_of(slot: Slot) -> tuple[int, int]:
    """Return the words in a row and in a slice of a brick."""
    _, y, x = slot.samples_zyx
    return x, x * y


def lay_out(stored: NDArray[Any], slot: Slot, words: NDArray[np.uint32]) -> None:
    """Write a brick's words; the last samples of one that is smaller than its slot are repeated."""
    beside, count = BESIDE[slot.kind], int(np.prod(slot.samples_zyx))
    missing = [(0, n + 1 - have) for n, have in zip(slot.samples_zyx, stored.shape, strict=True)]
    padded = np.pad(stored, missing, mode="edge")
    z, y, x = slot.samples_zyx
    words[count:] = 0
    parts = words[:count].view(stored.dtype).reshape(z, y, x, len(beside))
    for part, (up, down) in enumerate(beside):
        parts[..., part] = padded[up : up + z, down : down + y, :x]


def _lay_out_parts(parts: Sequence[Part | None], slot: Slot, words: NDArray[np.uint32]) -> None:
    """Write a brick of several volumes: its header, and the voxels of those volumes that it meets."""
    begin = slot.header_words * len(parts)
    for row, part, part_slot in zip(header_of(words, slot), parts, slot.parts, strict=True):
        write_header(row, begin, part)
        if part is not None:
            own = part.slot(part_slot)
            end = begin + words_of(own)
            lay_out(part.samples, own, words[begin:end])
            begin = end


def _parts_in(words: NDArray[np.uint32], slot: Slot) -> list[Part | None]:
    """Return the samples of each volume in a brick; None: it has none."""
    found: list[Part | None] = []
    for row, part_slot in zip(header_of(words, slot), slot.parts, strict=True):
        part = read_header(row, np.empty((0, 0, 0)), part_slot)
        samples = _samples(words[row[0] :], part.slot(part_slot)).copy() if row[0] >= 0 else None
        found.append(None if samples is None else replace(part, samples=samples))
    return found


def _samples(words: NDArray[np.uint32], slot: Slot) -> NDArray[Any]:
    count, kind = int(np.prod(slot.samples_zyx)), STORED_TYPE[slot.kind]
    samples: NDArray[Any] = words[:count].view(kind).reshape(*slot.samples_zyx, -1)[..., 0]
    return samples


def _address(words: NDArray[np.uint32]) -> int:
    address: int = words.__array_interface__["data"][0]
    return address
