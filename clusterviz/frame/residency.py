"""Bricks of a rank within a limit of memory: those that do not fit are loaded in passes while a frame is drawn.

A piece is cut into parts, boxes of bricks that fit, which are drawn from front to back (`render/passes.py`). A thread
reads the bricks of the next part while one is drawn. Which bricks are needed next is known from the order of the parts,
and the next frame is taken to have the same order; so the bricks dropped are those whose next use is farthest away,
which least recently used ones are not if all parts are drawn in turn.

The limit holds for three kinds of memory together: slots of the renderer, samples that were read, and decoded bricks of
stores, whose parts in the borders of other bricks are read again.

References
----------
L. A. Belady: A study of replacement algorithms for a virtual-storage computer, IBM Systems Journal 5(2), 1966.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence, Set
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import groupby
from threading import Event
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.data.store.cache import CACHE, CACHE_BYTES
from clusterviz.distribution.memory_budget import READING
from clusterviz.frame.brick_reader import BrickReader
from clusterviz.partition import BrickBox, Piece, bounding_box, build_tree, front_to_back
from clusterviz.plan.content import Bricks
from clusterviz.plan.plan import Plan
from clusterviz.render.choice import brick_bytes
from clusterviz.render.refraction import boxes_that_fit
from clusterviz.render.storage import slot_of

if TYPE_CHECKING:
    from clusterviz.render.renderer_cache import RendererCache

SLOTS, DECODED = 3 / 8, 1 / 4
"""Shares of a limit, if not all bricks fit; the rest is for samples. Without stores nothing is decoded."""
Batch = tuple[Future[Bricks], frozenset[Index], int]


@dataclass(frozen=True)
class Shares:
    """Division of a limit into the bytes of slots, of samples, and of decoded bricks of stores."""

    slots: int
    samples: int
    decoded: int

    @classmethod
    def of(cls, limit: int, total: int, largest: int, sample: int, decodes: bool) -> Shares:
        """Divide a limit by the bytes of the slots of all bricks, of the largest one, and of its samples at most."""
        decoded, reading = int(DECODED * limit * decodes), READING * sample
        if total + reading + decoded // 4 <= limit:
            decoded = min(decoded, limit - total - reading)
            return cls(total, limit - decoded - total, decoded)
        slots = max(largest, min(int(SLOTS * limit), limit - decoded - reading))
        decoded = max(0, min(decoded, limit - slots - reading))
        return cls(slots, max(reading, limit - slots - decoded), decoded)


class Residency:
    """Loading of a rank's bricks part by part, for `Passes`.

    The bricks that the reader has read are taken over.

    Attributes
    ----------
    seconds : spent in `load`, since `begin`
    passes : parts that were loaded since `begin`
    most_bytes : largest memory of slots, samples and decoded bricks since `begin`
    """

    def __init__(self, reader: BrickReader, renderers: RendererCache, on_cpu: bool) -> None:
        self._reader, self._renderers, self._on_cpu = reader, renderers, on_cpu
        self._samples: Bricks = {}
        self._held_bytes = 0
        self._batches: list[Batch] = []
        self._thread: ThreadPoolExecutor | None = None
        self._closed = Event()
        self._slot_bytes: dict[Index, int] = {}
        self._parts: list[tuple[Piece, Piece]] = []
        self._bricks: list[frozenset[Index]] = []
        self._skipped, self._loaded = set[BrickBox](), set[BrickBox]()
        self._missing = set[Index]()
        self.seconds, self.passes, self.most_bytes = 0.0, 0, 0

    def prepare(self, plan: Plan, holds: Set[Index], limit: int | None, most: int) -> Residency | None:
        """Drop bricks that do not suit a plan, and return this; None if all bricks may be loaded at once.

        Those that this rank `holds` may take `limit` bytes in memory; where that is None, `most`.
        """
        self._sizes = brick_bytes(plan, self._on_cpu)
        if limit is None and sum(int(self._sizes[index]) for index in holds) <= most:
            return None
        self._limit = most if limit is None else limit
        self._renderers.drop(self._renderers.missing(plan, self._renderers.bricks))
        return self

    def begin(self, plan: Plan, pieces: Sequence[Piece]) -> None:
        """Cut the pieces of a frame into parts."""
        self._collect(wait=False)
        held, self._samples, self._held_bytes = self._samples | self._reader.taken(), {}, 0
        self._take(plan.content.suiting(held))
        slot, sizes = slot_of(plan), self._sizes
        stored = {"u8": 1, "u16": 2, "f32": 4}[slot.kind]
        self._sample = slot.sample_bytes * max(1, -(-self._reader.itemsize // stored))
        self._plan, shown = plan, plan.cost > 0
        mine = [piece.members(shown) for piece in pieces]
        each = [sizes[tuple(bricks.T)] for bricks in mine if len(bricks)]
        total, largest = sum(int(one.sum()) for one in each), max((int(one.max()) for one in each), default=0)
        # Divide the limit between stored bricks, read samples and decoded bricks; cut the pieces so that parts fit.
        self._shares = Shares.of(self._limit, total, largest, self._sample, self._reader.decodes)
        CACHE.limit_bytes = self._shares.decoded
        self._parts = [(piece, part) for piece in pieces for part in self._cut(piece)]
        self._bricks = [_indices(part.members(shown)) for _, part in self._parts]
        self._order = {index: number for number, bricks in enumerate(self._bricks) for index in bricks}
        boxes = {part.box for _, part in self._parts}
        self._skipped, self._loaded = (boxes - self._loaded if self._loaded else set()), set()
        self._now, self._missing = -1, set()
        self.seconds, self.passes, self.most_bytes = 0.0, 0, 0
        if largest:
            self._renderers.reserve(min(sum(map(len, mine)), self._shares.slots // largest))
        self._fit_samples(0, after=len(self._parts))

    def parts(self, piece: Piece) -> list[Piece]:
        """Return the parts of a piece from front to back; see `Passes`."""
        return [part for whole, part in self._parts if whole is piece]

    def load(self, part: Piece, layer: Piece | None = None, following: Piece | None = None) -> None:
        """Load bricks of a part, and begin to read those of the next one; see `Passes`."""
        began = perf_counter()
        self._collect(wait=False)
        number = next((n for n, (_, one) in enumerate(self._parts) if one is part), 0)
        self.passes += number != self._now
        self._now = number
        self._loaded.add(self._parts[number][1].box)
        wanted = self._bricks[number] if layer is None else _indices(layer.members(self._plan.cost > 0))
        missing = self._missing = self._renderers.missing(self._plan, wanted)
        self._make_slots(missing, wanted)
        # Load what has been read, in the order in which reads end.
        while missing:
            ready = {index: self._samples[index] for index in missing & self._samples.keys()}
            missing.difference_update(ready)
            self._slot_bytes.update({index: int(self._sizes[index]) for index in ready})
            if ready:
                if len(self._parts) == 1:
                    self.drop(ready.keys())
                self._renderers.load(self._plan, ready)
            elif not any(bricks & missing for _, bricks, _ in self._batches):
                self._read(missing, needed=True)
            else:
                self._collect(wait=True)
        self._note()
        self._read_ahead(following)
        self.seconds += perf_counter() - began

    @property
    def held(self) -> set[Index]:
        """Indices of the bricks that were read, when all reads that were begun have ended."""
        while self._batches:
            self._collect(wait=True)
        return set(self._samples)

    def drop(self, bricks: Set[Index]) -> None:
        """Drop bricks that have changed."""
        for index in bricks & self._samples.keys():
            self._held_bytes -= self._samples.pop(index).nbytes

    def close(self) -> None:
        """Stop reading and free the samples."""
        self._closed.set()
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)
        self._thread, self._batches, self._samples, self._held_bytes = None, [], {}, 0
        CACHE.limit_bytes = CACHE_BYTES

    def _cut(self, piece: Piece) -> list[Piece]:
        """Return the shown bricks of a piece in boxes that fit into the slots, from front to back."""
        plan, most = self._plan, self._shares.slots
        bricks = piece.members(plan.cost > 0)
        if not len(bricks):
            return []
        sizes = self._sizes[tuple(bricks.T)]
        if int(sizes.sum()) <= most:
            return [piece]
        if plan.refraction:  # rays may wait for any brick of the box
            shown = np.where(plan.cost > 0, self._sizes, 0)
            return [replace(piece, box=box, bricks=None) for box in boxes_that_fit(shown, piece.box, most)]
        box = bounding_box(bricks)
        cost = np.zeros(box.shape_zyx)
        cost[tuple((bricks - box.begin_zyx).T)] = sizes
        count = -(-int(sizes.sum()) // most)
        leaves = (tree := build_tree(cost, count)).leaves
        while max(leaf.cost for leaf in leaves) > most:
            count += 1 + count // 16
            leaves = (tree := build_tree(cost, count)).leaves
        order = front_to_back(tree, plan.eye_in_bricks(box.begin_zyx), plan.view.forward)
        found = [np.argwhere(cost[leaves[n].box.slices]) + leaves[n].box.begin_zyx for n in order]
        return [piece.part(one + box.begin_zyx) for one in found if len(one)]

    def _distance(self, index: Index) -> int:
        if index in self._missing:
            return -1
        count = len(self._bricks)
        return (self._order[index] - self._now - 1) % count if index in self._order else count

    def _make_slots(self, missing: Set[Index], keep: Collection[Index]) -> None:
        there = self._renderers.bricks
        used = sum(self._slot_bytes.get(index, 0) for index in there)
        need = used + sum(int(self._sizes[index]) for index in missing) - self._shares.slots
        dropped = []
        for index in sorted(there - set(keep), key=self._distance, reverse=True):
            if need <= 0:
                break
            dropped.append(index)
            need -= self._slot_bytes.get(index, 0)
        self._renderers.drop(dropped)

    def _fit_samples(self, more: int, after: int) -> bool:
        """Drop samples until so many bytes more fit; only those that are used after a number of parts."""
        room = self._shares.samples - more - sum(size for *_, size in self._batches)
        if self._held_bytes > room:
            for index in sorted(self._samples, key=self._distance, reverse=True):
                if self._held_bytes <= room or self._distance(index) < after:
                    break
                self._held_bytes -= self._samples.pop(index).nbytes
        return self._held_bytes <= room

    def _read_ahead(self, part: Piece | None) -> None:
        """Begin to read a part, or the next one that rays reached in the last frame, as far as there is room."""
        rest = [(n, self._parts[n][1]) for n in range(self._now + 1, len(self._parts))]
        following = [n for n, one in rest if (one is part if part else one.box not in self._skipped)]
        if following:
            known = self._renderers.bricks | self._samples.keys()
            known |= {index for _, bricks, _ in self._batches for index in bricks}
            wanted = self._bricks[following[0]] - known
            while wanted and (read := self._read(wanted, needed=False, before=following[0] - self._now)):
                wanted -= read

    def _read(self, wanted: Collection[Index], needed: bool, before: int = 0) -> frozenset[Index]:
        """Begin to read bricks of one layer, as many as fit; none if there is no room and they are not needed yet."""
        _, layer = next(groupby(sorted(wanted), key=lambda index: index[0]))
        batch = list(layer)
        while not self._fit_samples(self._reading(batch), 0 if needed else before):
            if len(batch) == 1:
                if not needed:
                    return frozenset()
                if not self._batches:
                    break
                self._collect(wait=True)
            else:
                batch = batch[: len(batch) // 2]
        self._thread = self._thread or ThreadPoolExecutor(1, thread_name_prefix="read")
        bricks = frozenset(batch)
        future = self._thread.submit(self._reader.read, self._plan, bricks, self._closed.is_set)
        self._batches.append((future, bricks, self._reading(batch)))
        self._note()
        return bricks

    def _reading(self, batch: Sequence[Index]) -> int:
        around = bounding_box(np.array(batch, np.int64)).bricks
        return (len(batch) + around * (READING - 1)) * self._sample

    def _collect(self, wait: bool) -> None:
        """Take over what was read; with `wait` at least the batch that was begun first."""
        while self._batches and (wait or self._batches[0][0].done()):
            future, *_ = self._batches[0]
            found = future.result()
            del self._batches[0]
            self._take(found)
            wait = False

    def _take(self, bricks: Bricks) -> None:
        self.drop(bricks.keys())
        self._samples |= bricks
        self._held_bytes += sum(brick.nbytes for brick in bricks.values())

    def _note(self) -> None:
        samples = self._held_bytes + sum(size for *_, size in self._batches)
        self.most_bytes = max(self.most_bytes, self._renderers.held.get("voxel_bytes", 0) + samples + CACHE.bytes)


def _indices(bricks: NDArray[np.int64]) -> frozenset[Index]:
    return frozenset((z, y, x) for z, y, x in bricks.tolist())
