"""Memory for bricks: slots, side by side in large arrays.

Large arrays get large pages where the system has them, so that rays, which come to another page every few voxels, need
not look up where it is; and voxels that lie in few arrays can be told by numbers of 32 bits.
"""

from __future__ import annotations

from bisect import bisect
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

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
