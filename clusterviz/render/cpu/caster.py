"""Ray casting of one rank's bricks on the CPU: no OpenGL, and no upload.

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
from operator import length_hint
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm.placement import kernel_threads
from clusterviz.image.partial import PartialImage, Rect, blank
from clusterviz.partition import BrickBox, Piece, bounding_box
from clusterviz.plan.plan import Plan
from clusterviz.render.cpu.job_of_plan import VolumeJobs, domain_tables, hand_over, job_of, tables_of, volume_jobs
from clusterviz.render.cpu.kernel import Kernel, can_draw, kernel_of, mixed_kernel_of
from clusterviz.render.cpu.machine_code import compiled
from clusterviz.render.cpu.marching.adaptive_step import with_doublings
from clusterviz.render.cpu.marching.empty_space import skips_of
from clusterviz.render.cpu.marching.starts import COUNTS
from clusterviz.render.cpu.memory import Memory
from clusterviz.render.cpu.multi_volume_memory import MixedMemory
from clusterviz.render.cpu.transfer.pieces import Pieces, pieces_of
from clusterviz.render.cpu.width import Width, cpu_name, host_width
from clusterviz.render.frame_coherence import LastFrame, depth_of
from clusterviz.render.multi_volume_bricks import store_as
from clusterviz.render.render_result import (
    PROGRESS_SECONDS,
    SQUARE,
    PartOf,
    Progress,
    RenderResult,
    footprint,
    no_progress,
)
from clusterviz.render.storage import slot_of
from clusterviz.render.stored_brick import group_doublings, visible_groups
from clusterviz.scene.transfer import TransferFunction

Index = tuple[int, int, int]
BLOCK = 4  # the output's sides are multiples of it, so that every packet's pixels have a place
MAX_SKIP_TABLES = 64  # tables that are kept
Transfers = list[tuple[TransferFunction, float]]
"""Of each volume, and the length of what its pieces give the opacity of, in opacity unit distances."""


@dataclass(frozen=True, eq=False)
class _Shown:
    """The bricks that a piece shows in any window: how many, which, in which box, and the tables of both.

    Of several volumes, what is said of each, too.
    """

    piece: Piece
    bricks: int
    members: bytes
    box: BrickBox
    tables: dict[str, Any]
    volumes: VolumeJobs | None = None

    @property
    def wide(self) -> bool:
        """Whether the numbers of voxels take 64 bits."""
        return self.volumes.wide if self.volumes else self.tables["bricks"].itemsize == 8


class VectorCaster:
    """One rank's ray caster on the CPU: its kernel, its bricks.

    Parameters
    ----------
    plan : decides the kernel, and how bricks are kept
    width : of the vectors; by default the CPU's own

    Attributes
    ----------
    slot : what a brick takes
    pool : the bricks that are here
    """

    def __init__(self, plan: Plan, width: Width | None = None) -> None:
        self._width, self._threads = width or host_width(), kernel_threads()
        self.slot = slot_of(plan)
        self.pool = self._empty_pool()
        self._skips: dict[Any, NDArray[np.int32]] = {}
        self._pieces: tuple[Transfers, tuple[Pieces | None, ...]] = [], ()
        self._shown: tuple[Any, ...] | None = None
        self._last_frame = LastFrame()
        self.compile(plan)

    @property
    def renderer(self) -> str:
        """What draws, in words."""
        return cpu_name(self._width)

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
        if self._kernel.frame_coherence:
            from clusterviz.render.frame_coherence import prepare_reprojection

            prepare_reprojection()

    def load(self, plan: Plan, bricks: MutableMapping[Index, Any]) -> None:
        """Keep bricks beside those that are there, taken out as they are laid out.

        Parameters
        ----------
        bricks : samples (z, y, x), or the `MultiVolumeBrick` of several volumes, by index
        """
        self._skips = {}
        if bricks:
            self._last_frame.forget()
        self.pool.put(bricks, store_as(plan, self.slot))

    def drop(self, bricks: Iterable[Index]) -> None:
        """Give up bricks that are there."""
        if bricks := set(bricks):
            self._last_frame.forget()
        self.pool.drop(bricks)

    def draw(self, plan: Plan, pieces: Iterable[Piece], progress: Progress = no_progress) -> list[RenderResult]:
        """Draw one frame's pieces: the bricks that they show are there.

        Parameters
        ----------
        pieces : the next is asked for when the one before is drawn
        progress : called what part of them is drawn, where it is known how many they are

        Returns
        -------
        drawn : one a piece; its partial image is the rectangle that the piece's box may cover in its window
        """
        drawn: list[RenderResult] = []
        shown: _Shown | None = None
        self._last_frame.next_frame()
        count = length_hint(pieces)
        for number, piece in enumerate(pieces):
            started, rect = perf_counter(), footprint(plan, piece)
            # Windows of the same bricks share their tables.
            if shown is None or not piece.shows_bricks_of(shown.piece):
                shown = self._shown_by(plan, piece)
            blank_piece = shown.bricks == 0 or rect.pixels == 0
            part = PartOf(progress, number, count)
            drawn.append(RenderResult(blank()) if blank_piece else self._draw_piece(plan, rect, shown, started, part))
        return drawn

    def release(self) -> None:
        """Forget the bricks."""
        self._skips, self.pool = {}, self._empty_pool()

    def _empty_pool(self) -> Memory | MixedMemory:
        return MixedMemory(self.slot) if self.slot.parts else Memory(self.slot)

    def _kernel_of(self, plan: Plan) -> Kernel:
        lanes, pieces = self._width.lanes, self._pieces_of(plan)
        return mixed_kernel_of(plan, lanes, pieces) if plan.multi_volume else kernel_of(plan, lanes, pieces[0])

    def _pieces_of(self, plan: Plan) -> tuple[Pieces | None, ...]:
        """Of each volume the transfer function's pieces, where they are few: kept until one changes."""
        each, known = transfers_of(plan), self._pieces[0]
        kept = len(each) == len(known) and all(a is b and u == v for (a, u), (b, v) in zip(each, known, strict=True))
        if not kept:
            self._pieces = each, tuple(pieces_of(*one) for one in each)
        return self._pieces[1]

    def _shown_by(self, plan: Plan, piece: Piece) -> _Shown:
        """The bricks of a piece, as its windows are drawn of them."""
        bricks = piece.members(plan.cost > 0)
        if len(bricks) == 0:
            return _Shown(piece, 0, b"", piece.box, {})
        box = bounding_box(bricks)
        pieces, skips, volumes = self._pieces_of(plan), self._skips_of(plan, box, bricks), None
        if isinstance(self.pool, MixedMemory):
            volumes = volume_jobs(plan, self.slot, self.pool.numbered(box, bricks), pieces)
            tables = domain_tables(plan, skips) | {"volumes": volumes.records}
        else:
            tables = tables_of(plan, self.pool.numbered(box, bricks), skips, pieces[0])
            if self.slot.layout:
                tables["pitches"] = self.pool.pitches(box, bricks)
        return _Shown(piece, len(bricks), bricks.tobytes(), box, tables, volumes)

    def _draw_piece(self, plan: Plan, rect: Rect, shown: _Shown, started: float, progress: Progress) -> RenderResult:
        pixels = np.empty((-(-rect.height // BLOCK) * BLOCK, -(-rect.width // BLOCK) * BLOCK, 4), np.float32)
        work = np.zeros((-(-rect.height // SQUARE), -(-rect.width // SQUARE)), np.uint32)
        job = job_of(plan, (shown.box, shown.bricks), rect, self.slot, shown.tables | {"pixels": pixels, "work": work})
        memory, members = dict[str, NDArray[np.float32]](), (shown.box, shown.members)
        if plan.march.frame_coherence is not None:
            memory = self._last_frame.arrays(plan, members, rect, pixels.shape[:2])
            hand_over(job, memory, depth_of(plan), plan.march.frame_coherence)
        self._run(job, shown.wide, progress)
        frame_coherence = None
        if memory:
            counts = (int(job[name][0]) for name in COUNTS)
            frame_coherence = self._last_frame.finish(members, memory["starts"][: rect.height, : rect.width], *counts)
        rgba = np.ascontiguousarray(pixels[: rect.height, : rect.width])
        seconds = perf_counter() - started
        return RenderResult(
            PartialImage(rect, rgba), int(job["taken"][0]), shown.bricks, seconds, 0.0, work, 0, frame_coherence
        )

    def _run(self, job: NDArray[np.void], wide: bool, progress: Progress) -> None:
        """Let all threads draw tiles until there are none; this one waits, so that it can be interrupted."""
        address, cast = job.__array_interface__["data"][0], compiled(replace(self._kernel, wide=wide))
        threads = [_pool(os.getpid()).submit(cast, address) for _ in range(self._threads)]
        tiles = int(job["tiles"][0])
        try:
            while wait(threads, PROGRESS_SECONDS).not_done:
                progress(min(1.0, int(job["counter"][0]) / tiles))
        finally:
            # After an interrupt there are no more tiles; those that are being drawn write to memory of this frame.
            job["counter"] = tiles
            wait(threads)

    def _skips_of(self, plan: Plan, box: BrickBox, bricks: NDArray[np.int64]) -> NDArray[np.int32]:
        """They last until the transfer function changes."""
        parts = plan.multi_volume.volume_layers if plan.multi_volume else ()
        shown = (
            plan.blend_mode,
            plan.march.adaptive_step,
            plan.transfer,
            *(one for p in parts for one in (p.blend_mode, p.transfer)),
        )
        if self._shown is None or any(a is not b for a, b in zip(self._shown, shown, strict=True)):
            self._skips, self._shown = {}, shown
        if (found := self._skips.get((box, bricks.tobytes()))) is not None:
            return found
        if len(self._skips) >= MAX_SKIP_TABLES:
            self._skips = {}
        ranges, (begin, end) = self.pool.ranges(bricks), plan.layout.unit_box(box.begin_zyx, box.end_zyx)
        visible, places = visible_groups(ranges, plan), plan.layout.units(bricks) - begin
        found = skips_of(visible, places, BrickBox(begin, end).shape_zyx, plan.layout.brick)
        if plan.march.adaptive_step is not None and isinstance(self.pool, Memory):
            found = with_doublings(found, places, visible, group_doublings(ranges, self.pool.bends(bricks), plan))
        self._skips[box, bricks.tobytes()] = found
        return found


def transfers_of(plan: Plan) -> Transfers:
    """Those of a plan: of several volumes extinctions are added, so that the opacity of unit lengths is needed."""
    if plan.multi_volume is None:
        return [(plan.transfer, plan.march.slab_units)]
    return [(part.transfer, 1.0) for part in plan.multi_volume.volume_layers]


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Threads that wait for work, made as they are needed; a forked process has none of its parent's."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="cast")
