"""Memory for bricks, all of one size: slots, side by side in large arrays.

Large arrays get large pages where the system has them, so that rays, which come to another page every few voxels, need
not look up where it is; and voxels that lie in few arrays can be told by numbers of 32 bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

LEAST_CHUNK = 1 << 24  # bytes of an array; nobody has them before they are written


@dataclass(eq=False)
class _Chunk:
    """An array of slots.

    Attributes
    ----------
    words : uint32 (slots, words of a slot)
    touched : slots that have been taken so far, from the first on
    free : those of them that have been given back
    """

    words: NDArray[np.uint32]
    touched: int = 0
    free: list[int] = field(default_factory=list)

    @property
    def room(self) -> int:
        """Slots that can be taken."""
        return len(self.words) - self.touched + len(self.free)

    def take(self) -> int:
        """A free slot's number."""
        if self.free:
            return self.free.pop()
        self.touched += 1
        return self.touched - 1


@dataclass(frozen=True, eq=False)
class Taken:
    """A slot that is taken.

    Attributes
    ----------
    words : uint32 (words of a slot,)
    chunk : the array in which it is
    number : which of its slots it is
    """

    words: NDArray[np.uint32]
    chunk: _Chunk
    number: int


class Slots:
    """Slots that are taken and given back one by one; an array goes when all of its slots are free.

    Parameters
    ----------
    words : 32-bit words of a slot
    """

    def __init__(self, words: int) -> None:
        self._words = words
        self._chunks: list[_Chunk] = []

    @property
    def bytes(self) -> int:
        """Memory that slots have taken, those that have been given back included while their array stays."""
        return 4 * self._words * sum(chunk.touched for chunk in self._chunks)

    def make_room(self, slots: int) -> None:
        """Let so many slots be free, side by side if there are not enough."""
        missing = slots - sum(chunk.room for chunk in self._chunks)
        if missing > 0:
            count = max(missing, LEAST_CHUNK // (4 * self._words))
            self._chunks.append(_Chunk(np.empty((count, self._words), np.uint32)))

    def take(self) -> Taken:
        """A free slot; what is in it is anything."""
        self.make_room(1)
        chunk = next(chunk for chunk in self._chunks if chunk.room)
        number = chunk.take()
        return Taken(chunk.words[number], chunk, number)

    def give_back(self, slot: Taken) -> None:
        """Let a slot be free again."""
        slot.chunk.free.append(slot.number)
        if len(slot.chunk.free) == slot.chunk.touched:
            self._chunks.remove(slot.chunk)
