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

Index = tuple[int, int, int]
T = TypeVar("T")
VOXEL_BYTES = 4
BESIDE = {"u8": ((0, 0), (0, 1), (1, 0), (1, 1)), "u16": ((0, 0), (0, 1)), "f32": ((0, 0),)}
"""By stored type: the voxels that lie beside each one, (z, y) further on."""


@dataclass(frozen=True, eq=False)
class Kept:
    """A brick.

    Attributes
    ----------
    words : uint32, one a voxel of the slot, and one behind them that loads may touch
    low, high : smallest and largest finite sample of its groups of cells
    voxels : samples that it was made of
    bend : of its groups, see `bends.py`; None where slabs are not stretched
    """

    words: NDArray[np.uint32]
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
        self._kept: dict[Index, Kept] = {}

    @property
    def bricks(self) -> set[Index]:
        """Those that are here."""
        return set(self._kept)

    @property
    def bytes(self) -> int:
        """Memory taken by voxels."""
        return sum(kept.words.nbytes for kept in self._kept.values())

    @property
    def voxels(self) -> int:
        """Samples of which the bricks were made."""
        return sum(kept.voxels for kept in self._kept.values())

    def put(self, bricks: MutableMapping[Index, T], stored: Callable[[T], Stored]) -> None:
        """Keep bricks beside those that are here; each is taken out, so that none is held twice for long."""
        for index in list(bricks):
            brick = stored(bricks.pop(index))
            words = laid_out(brick.samples, self._slot)
            self._kept[index] = Kept(words, brick.low, brick.high, brick.voxels, brick.bend)

    def stored(self, bricks: Iterable[Index]) -> Iterator[tuple[Index, Stored]]:
        """Bricks that are here, as every caster can take them."""
        shape, kind = (*self._slot.samples_zyx, -1), STORED_TYPE[self._slot.kind]
        for index in bricks:
            kept = self._kept[index]
            samples = kept.words[:-1].view(kind).reshape(shape)[..., 0]
            yield index, Stored(samples, kept.low, kept.high, kept.voxels, kept.bend)

    def drop(self, bricks: Iterable[Index]) -> None:
        """Give up bricks."""
        for index in bricks:
            self._kept.pop(index, None)

    def addresses(self, box: BrickBox, bricks: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where the voxels of bricks begin, int64 of the box's shape; 0 for others.

        Parameters
        ----------
        bricks : int64 (m, 3), indices (z, y, x) in the box

        Raises
        ------
        KeyError
            One of them is not here.
        """
        found = np.zeros(box.shape_zyx, np.int64)
        starts = [self._kept[z, y, x].words.__array_interface__["data"][0] for z, y, x in bricks.tolist()]
        found[tuple((bricks - box.begin_zyx).T)] = starts
        return found

    def ranges(self, bricks: NDArray[np.int64]) -> Ranges:
        """Lowest and highest samples of the groups of bricks, (m, *slot.groups_zyx) each."""
        kept = [self._kept[z, y, x] for z, y, x in bricks.tolist()]
        return np.stack([one.low for one in kept]), np.stack([one.high for one in kept])

    def bends(self, bricks: NDArray[np.int64]) -> NDArray[np.float32]:
        """How bent the field is in the groups of bricks, (m, 2, *slot.groups_zyx): see `bends.py`."""
        found = [self._kept[z, y, x].bend for z, y, x in bricks.tolist()]
        return np.stack([bend for bend in found if bend is not None])


def laid_out(stored: NDArray[Any], slot: Slot) -> NDArray[np.uint32]:
    """One brick's words; the last samples of a smaller one are repeated."""
    beside = BESIDE[slot.kind]
    missing = [(0, n + 1 - have) for n, have in zip(slot.samples_zyx, stored.shape, strict=True)]
    padded = np.pad(stored, missing, mode="edge")
    z, y, x = slot.samples_zyx
    words = np.zeros(z * y * x + 1, np.uint32)
    parts = words[:-1].view(stored.dtype).reshape(z, y, x, len(beside))
    for part, (up, down) in enumerate(beside):
        parts[..., part] = padded[up : up + z, down : down + y, :x]
    return words
