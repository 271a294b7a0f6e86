"""Ray casting of one rank's bricks on the processor: no OpenGL, and no upload.

Threads take tiles of the picture from a counter. As many are used as the rank has cores.

References
----------
I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing, Eurographics 2001
(packets of rays in vector registers).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, MutableMapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.place import kernel_threads
from clusterviz.image.partial import PartialImage, blank
from clusterviz.image.region import Rect
from clusterviz.partition import BrickBox, Piece, bounding_box
from clusterviz.plan.plan import Plan
from clusterviz.render.bends import group_doublings
from clusterviz.render.drawn import SQUARE, Drawn, footprint
from clusterviz.render.emptiness import visible_groups
from clusterviz.render.storage import make_slot
from clusterviz.render.stored import store
from clusterviz.render.vectors.coherence.last_frame import LastFrame, depth_of
from clusterviz.render.vectors.coherence.reprojection import prepare_reprojection
from clusterviz.render.vectors.kernel import Kernel, can_draw, kernel_of
from clusterviz.render.vectors.machine_code import compiled
from clusterviz.render.vectors.marching.leaps import leaps_of
from clusterviz.render.vectors.marching.stretch import with_doublings
from clusterviz.render.vectors.memory import Memory
from clusterviz.render.vectors.order import hand_over, job_of, leaping_of, tables_of
from clusterviz.render.vectors.transfer.pieces import Pieces, pieces_of
from clusterviz.render.vectors.width import Width, host_width, processor_name

Index = tuple[int, int, int]
BLOCK = 4  # the output's sides are multiples of it, so that every packet's pixels have a place
MOST_LEAPS = 64  # tables that are kept


@dataclass(frozen=True, eq=False)
class _Shown:
    """The bricks that a piece shows in any window: how many, which, in which box, and the tables of both."""

    piece: Piece
    bricks: int
    members: bytes
    box: BrickBox
    tables: dict[str, Any]


class VectorCaster:
    """One rank's ray caster on the processor: its kernel, its bricks.

    Parameters
    ----------
    plan : decides the kernel, and how bricks are kept
    width : of the vectors; by default the processor's own

    Attributes
    ----------
    slot : what a brick takes
    pool : the bricks that are here
    """

    def __init__(self, plan: Plan, width: Width | None = None) -> None:
        self._width, self._threads = width or host_width(), kernel_threads()
        self.slot = make_slot(plan.layout, plan.encoding, plan.march)
        self.pool = Memory(self.slot)
        self._leaps: dict[Any, NDArray[np.int32]] = {}
        self._pieces: tuple[Any, float, Pieces | None] | None = None
        self._shown: tuple[Any, ...] | None = None
        self._last_frame = LastFrame()
        self.compile(plan)

    @property
    def renderer(self) -> str:
        """What draws, in words."""
        return processor_name(self._width)

    @property
    def voxel_bytes(self) -> int:
        """Memory taken by voxels."""
        return self.pool.bytes

    def can_draw(self, plan: Plan) -> bool:
        """Whether the kernel is that of a plan."""
        return can_draw(plan) and self._kernel == self._kernel_of(plan)

    def compile(self, plan: Plan) -> None:
        """Make the kernel of another plan with the same slots; the bricks stay."""
        self._kernel = self._kernel_of(plan)
        compiled(self._kernel)
        if self._kernel.leaping:
            prepare_reprojection()

    def load(self, plan: Plan, bricks: MutableMapping[Index, NDArray[Any]]) -> None:
        """Keep bricks beside those that are there: samples (z, y, x) by index, taken out as they are laid out."""
        self._leaps = {}
        if bricks:
            self._last_frame.forget()
        self.pool.put(bricks, lambda voxels: store(voxels, plan.encoding, self.slot))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Give up bricks that are there."""
        if bricks := set(bricks):
            self._last_frame.forget()
        self.pool.drop(bricks)

    def draw(self, plan: Plan, pieces: Iterable[Piece]) -> list[Drawn]:
        """Draw one frame's pieces: the bricks that they show are there.

        Parameters
        ----------
        pieces : the next is asked for when the one before is drawn

        Returns
        -------
        drawn : one a piece; its partial image is the rectangle that the piece's box may cover in its window
        """
        drawn: list[Drawn] = []
        shown: _Shown | None = None
        self._last_frame.next_frame()
        for piece in pieces:
            started, rect = perf_counter(), footprint(plan, piece)
            # Windows of the same bricks share their tables.
            if shown is None or not piece.shows_bricks_of(shown.piece):
                shown = self._shown_by(plan, piece)
            blank_piece = shown.bricks == 0 or rect.pixels == 0
            drawn.append(Drawn(blank()) if blank_piece else self._draw_piece(plan, rect, shown, started))
        return drawn

    def release(self) -> None:
        """Forget the bricks."""
        self._leaps, self.pool = {}, Memory(self.slot)

    def _kernel_of(self, plan: Plan) -> Kernel:
        return kernel_of(plan, self._width.lanes, self._pieces_of(plan))

    def _pieces_of(self, plan: Plan) -> Pieces | None:
        """The transfer function's pieces, where they are few: kept until it changes."""
        known = plan.transfer, plan.march.slab_units
        if self._pieces is None or self._pieces[0] is not known[0] or self._pieces[1] != known[1]:
            self._pieces = (*known, pieces_of(plan))
        return self._pieces[2]

    def _shown_by(self, plan: Plan, piece: Piece) -> _Shown:
        """The bricks of a piece, as its windows are drawn of them."""
        bricks = piece.members(plan.cost > 0)
        if len(bricks) == 0:
            return _Shown(piece, 0, b"", piece.box, {})
        box = bounding_box(bricks)
        tables = tables_of(plan, self.pool.numbered(box, bricks), self._leaps_of(plan, box, bricks))
        pieces = self._pieces_of(plan)
        tables |= {} if pieces is None else {"pieces": pieces.table}
        return _Shown(piece, len(bricks), bricks.tobytes(), box, tables)

    def _draw_piece(self, plan: Plan, rect: Rect, shown: _Shown, started: float) -> Drawn:
        pixels = np.empty((-(-rect.height // BLOCK) * BLOCK, -(-rect.width // BLOCK) * BLOCK, 4), np.float32)
        work = np.zeros((-(-rect.height // SQUARE), -(-rect.width // SQUARE)), np.uint32)
        job = job_of(plan, (shown.box, shown.bricks), rect, self.slot, shown.tables | {"pixels": pixels, "work": work})
        memory: dict[str, NDArray[np.float32]] = {}
        if plan.march.leaping is not None:
            memory = self._last_frame.arrays(plan, (shown.box, shown.members), rect, pixels.shape[:2])
            hand_over(job, memory, depth_of(plan), plan.march.leaping)
        self._run(job, wide=shown.tables["bricks"].itemsize == 8)
        leaping = leaping_of(job, memory["starts"][: rect.height, : rect.width]) if memory else None
        rgba = np.ascontiguousarray(pixels[: rect.height, : rect.width])
        seconds = perf_counter() - started
        return Drawn(PartialImage(rect, rgba), int(job["taken"][0]), shown.bricks, seconds, 0.0, work, 0, leaping)

    def _run(self, job: NDArray[np.void], wide: bool) -> None:
        """Let all threads draw tiles until there are none."""
        address, cast = job.__array_interface__["data"][0], compiled(replace(self._kernel, wide=wide))
        others = [_pool(os.getpid()).submit(cast, address) for _ in range(self._threads - 1)]
        cast(address)
        wait(others)

    def _leaps_of(self, plan: Plan, box: BrickBox, bricks: NDArray[np.int64]) -> NDArray[np.int32]:
        """They last until the transfer function changes."""
        shown = (plan.look, plan.transfer, plan.march.stretching)
        if self._shown is None or any(a is not b for a, b in zip(self._shown, shown, strict=True)):
            self._leaps, self._shown = {}, shown
        if (found := self._leaps.get((box, bricks.tobytes()))) is not None:
            return found
        if len(self._leaps) >= MOST_LEAPS:
            self._leaps = {}
        ranges, places = self.pool.ranges(bricks), bricks - box.begin_zyx
        visible = visible_groups(ranges, plan)
        found = leaps_of(visible, places, box.shape_zyx, plan.layout.brick)
        if plan.march.stretching is not None:
            found = with_doublings(found, places, visible, group_doublings(ranges, self.pool.bends(bricks), plan))
        self._leaps[box, bricks.tobytes()] = found
        return found


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Threads that wait for work, made as they are needed; a forked process has none of its parent's."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="cast")
