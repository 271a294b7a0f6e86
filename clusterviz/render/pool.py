"""The bricks that a rank has in GPU memory: taken and given up one by one, in few buffers or textures.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, MutableMapping
from functools import partial
from typing import TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import UNASSIGNED, Owners, bounding_box, visible_groups
from clusterviz.plan.plan import Plan
from clusterviz.render.brick_atlas import BrickAtlas
from clusterviz.render.chunks import chunks_of
from clusterviz.render.storage import Slot
from clusterviz.render.stored_brick import Stored

Index = tuple[int, int, int]
T = TypeVar("T")
GROWTH = 1.25  # of a residence that is full, at least: bricks that come one by one are not copied each time


class BrickPool:
    """Bricks by index.

    Parameters
    ----------
    context : a context that this thread has current
    slot : what a brick takes
    capacity : bricks that one residence may hold
    most : bricks for which there may be room, where no more are needed; None: any
    """

    def __init__(self, context: moderngl.Context, slot: Slot, capacity: int, most: int | None = None) -> None:
        self._context, self._slot, self._capacity, self._most = context, slot, capacity, most
        self._residences: list[BrickAtlas] = []
        self._waiting: dict[Index, Callable[[], Stored]] = {}

    @property
    def bricks(self) -> set[Index]:
        """Those that are here, be it that they wait."""
        return {index for residence in self._residences for index in residence.slots} | self._waiting.keys()

    @property
    def bytes(self) -> int:
        """GPU memory taken by voxels, free slots included."""
        return sum(residence.bytes for residence in self._residences)

    @property
    def voxels(self) -> int:
        """Samples of which the bricks were made."""
        return sum(residence.voxels for residence in self._residences)

    def put(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Keep bricks beside those that are here; each is taken out, so that none is held twice for long."""
        for residence in self._residences:
            for index in sorted(bricks)[: residence.free]:
                residence.put(index, stored(index, bricks.pop(index)))
        for chunk in chunks_of(bricks.keys(), self._capacity):
            residence = self._with_room(len(chunk))
            for index in chunk:
                residence.put(index, stored(index, bricks.pop(index)))

    def put_later(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Keep bricks, taken out, in this process's memory until they are asked for."""
        for index in list(bricks):
            self._waiting[index] = partial(stored, index, bricks.pop(index))

    def stored(self, bricks: Iterable[Index]) -> Iterator[tuple[Index, Stored]]:
        """Bricks read back from the GPU."""
        wanted = set(bricks)
        self._fetch(wanted)
        for residence in self._residences:
            yield from residence.stored(sorted(wanted & residence.slots.keys()))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Give up bricks."""
        wanted = set(bricks)
        for index in wanted & self._waiting.keys():
            del self._waiting[index]
        for residence in self._residences:
            for index in wanted & residence.slots.keys():
                residence.drop(index)

    def parts(self, plan: Plan, bricks: NDArray[np.int64]) -> Iterator[tuple[BrickAtlas, NDArray[np.int64]]]:
        """Bricks by where they are, in parts that can be drawn one behind the other.

        Parameters
        ----------
        bricks : int64 (m, 3), indices (z, y, x), m at least 1; no ray leaves them for others and comes back

        Raises
        ------
        KeyError
            One of them is not here.
        """
        self._fetch({(z, y, x) for z, y, x in bricks.tolist()})
        if len(self._residences) == 1:
            yield self._residences[0], bricks
            return
        where = {index: number for number, residence in enumerate(self._residences) for index in residence.slots}
        box = bounding_box(bricks)
        owner = np.full(box.shape_zyx, UNASSIGNED, np.int32)
        owner[tuple((bricks - box.begin_zyx).T)] = [where[z, y, x] for z, y, x in bricks.tolist()]
        for group in visible_groups(
            Owners(len(self._residences), owner), plan.eye_in_bricks(box.begin_zyx), plan.view.forward
        ):
            yield self._residences[group.rank], group.bricks + box.begin_zyx

    def release(self) -> None:
        """Give everything back to the driver."""
        for residence in self._residences:
            residence.release()
        self._residences, self._waiting = [], {}

    def _fetch(self, bricks: set[Index]) -> None:
        """Put those of them that wait."""
        self.put({index: self._waiting.pop(index) for index in bricks & self._waiting.keys()}, lambda _, make: make())

    def _with_room(self, bricks: int) -> BrickAtlas:
        """A residence with free slots: the last one, grown, or another."""
        last = self._residences[-1] if self._residences else None
        if last is not None and last.room - last.free + bricks <= self._capacity:
            room = min(self._capacity, int(GROWTH * last.room))
            if self._most is not None:
                room = min(room, self._most - sum(other.room for other in self._residences[:-1]))
            room = max(room, last.room - last.free + bricks)
            self._residences[-1] = last.grown(room)
        else:
            self._residences.append(BrickAtlas(self._context, self._slot, bricks))
        return self._residences[-1]
