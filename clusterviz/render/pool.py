"""Pool of a rank's bricks in GPU memory, in few atlases, from which bricks are added and dropped one by one.

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
GROWTH = 1.25  # least growth of a full atlas, so that bricks which come one by one are not copied each time


class BrickPool:
    """Bricks in GPU memory, by index.

    Parameters
    ----------
    context : a context that this thread has current
    slot : layout of a brick
    capacity : most bricks of one atlas
    most : most slots in all, unless more are needed; None: no limit
    """

    def __init__(self, context: moderngl.Context, slot: Slot, capacity: int, most: int | None = None) -> None:
        self._context, self._slot, self._capacity, self._most = context, slot, capacity, most
        self._atlases: list[BrickAtlas] = []
        self._waiting: dict[Index, Callable[[], Stored]] = {}

    @property
    def bricks(self) -> set[Index]:
        """Indices of all bricks, including those not uploaded yet."""
        return {index for atlas in self._atlases for index in atlas.slots} | self._waiting.keys()

    @property
    def bytes(self) -> int:
        """Bytes of GPU memory, including free slots."""
        return sum(atlas.bytes for atlas in self._atlases)

    @property
    def voxels(self) -> int:
        """Number of samples of the bricks."""
        return sum(atlas.voxels for atlas in self._atlases)

    def put(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Add bricks; each is removed from the mapping, so that none is held twice for long."""
        for atlas in self._atlases:
            for index in sorted(bricks)[: atlas.free]:
                atlas.put(index, stored(index, bricks.pop(index)))
        for chunk in chunks_of(bricks.keys(), self._capacity):
            atlas = self._with_free_slots(len(chunk))
            for index in chunk:
                atlas.put(index, stored(index, bricks.pop(index)))

    def put_later(self, bricks: MutableMapping[Index, T], stored: Callable[[Index, T], Stored]) -> None:
        """Add bricks, removed from the mapping, that stay in host memory until they are needed."""
        for index in list(bricks):
            self._waiting[index] = partial(stored, index, bricks.pop(index))

    def stored(self, bricks: Iterable[Index]) -> Iterator[tuple[Index, Stored]]:
        """Read bricks back from the GPU."""
        wanted = set(bricks)
        self._fetch(wanted)
        for atlas in self._atlases:
            yield from atlas.stored(sorted(wanted & atlas.slots.keys()))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Drop bricks."""
        wanted = set(bricks)
        for index in wanted & self._waiting.keys():
            del self._waiting[index]
        for atlas in self._atlases:
            for index in wanted & atlas.slots.keys():
                atlas.drop(index)

    def parts(self, plan: Plan, bricks: NDArray[np.int64]) -> Iterator[tuple[BrickAtlas, NDArray[np.int64]]]:
        """Yield bricks by atlas, in parts that can be drawn one behind the other.

        Parameters
        ----------
        bricks : int64 (m, 3), indices (z, y, x), m at least 1; no ray leaves them for others and returns

        Raises
        ------
        KeyError
            A brick is not in the pool.
        """
        self._fetch({(z, y, x) for z, y, x in bricks.tolist()})
        if len(self._atlases) == 1:
            yield self._atlases[0], bricks
            return
        where = {index: number for number, atlas in enumerate(self._atlases) for index in atlas.slots}
        box = bounding_box(bricks)
        owner = np.full(box.shape_zyx, UNASSIGNED, np.int32)
        owner[tuple((bricks - box.begin_zyx).T)] = [where[z, y, x] for z, y, x in bricks.tolist()]
        for group in visible_groups(
            Owners(len(self._atlases), owner), plan.eye_in_bricks(box.begin_zyx), plan.view.forward
        ):
            yield self._atlases[group.rank], group.bricks + box.begin_zyx

    def release(self) -> None:
        """Free all GPU memory."""
        for atlas in self._atlases:
            atlas.release()
        self._atlases, self._waiting = [], {}

    def _fetch(self, bricks: set[Index]) -> None:
        """Upload those of the bricks that are in host memory."""
        self.put({index: self._waiting.pop(index) for index in bricks & self._waiting.keys()}, lambda _, make: make())

    def _with_free_slots(self, bricks: int) -> BrickAtlas:
        """Return an atlas with free slots: the last one, enlarged, or a new one."""
        last = self._atlases[-1] if self._atlases else None
        if last is not None and last.slot_count - last.free + bricks <= self._capacity:
            slot_count = min(self._capacity, int(GROWTH * last.slot_count))
            if self._most is not None:
                slot_count = min(slot_count, self._most - sum(other.slot_count for other in self._atlases[:-1]))
            slot_count = max(slot_count, last.slot_count - last.free + bricks)
            self._atlases[-1] = last.grown(slot_count)
        else:
            self._atlases.append(BrickAtlas(self._context, self._slot, bricks))
        return self._atlases[-1]
