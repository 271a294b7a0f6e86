"""Drawing on one rank: its bricks are loaded, its pieces drawn, and the costs counted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import replace
from functools import partial
from time import perf_counter, process_time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import abort_on_failure
from clusterviz.composite.opacity_in_front import opacity_in_front
from clusterviz.data.source import Index
from clusterviz.frame.brick_reader import BrickReader
from clusterviz.frame.residency import Residency
from clusterviz.frame.run import Options, Run
from clusterviz.frame.work import RankWork, SampleCounts
from clusterviz.gl.devices import prefers_cpu
from clusterviz.image.partial import PartialImage, Rect, joined
from clusterviz.partition import Piece
from clusterviz.render.stored_brick import stamp_of
from clusterviz.report.counts import all_counts
from clusterviz.report.machine import HELD_SHARE_OF_MEMORY, memory
from clusterviz.report.statistics import RankFrame

if TYPE_CHECKING:
    from clusterviz.plan.plan import Plan
    from clusterviz.render.crossing import FoundLayers
    from clusterviz.render.render_result import RenderResult
    from clusterviz.render.renderer_cache import RendererCache
    from clusterviz.render.stored_brick import Stored


class Drawing:
    """Renderer of this rank, kept from frame to frame; a rank without bricks opens no OpenGL context.

    Attributes
    ----------
    sample_counts : of each piece drawn last
    fragments : for each piece drawn last, as `RenderResult.fragments`
    """

    def __init__(self, reader: BrickReader) -> None:
        self._reader = reader
        self._renderers: RendererCache | None = None
        self.sample_counts: list[SampleCounts] = []
        self.fragments: list[NDArray[np.int32]] = []
        self._received: dict[Index, tuple[int, Stored]] = {}
        self._pieces: list[Piece] = []
        self._passes: Residency | None = None
        self._residency: Residency | None = None
        self._most_bytes: int | None = None
        self._read = 0, 0

    def load(self, run: Run, work: RankWork) -> None:
        """Compile shaders, read bricks and upload them, as far as they are missing; collective.

        Bricks that may not all be in memory are loaded as they are drawn.
        """
        from clusterviz.render.renderer_cache import RendererCache

        plan, holds = work.plan, work.holds
        if plan is None:
            return
        renderers = self._renderers = self._renderers or RendererCache(work.scene.cluster.memory_limit)
        renderers.keep(holds)
        received = self._received_for(plan, holds)
        passes = self._passes = self._in_passes(run, work, renderers)
        missing = set() if passes else renderers.missing(plan, holds) - received.keys()
        # If no rank lacks bricks or programs, nothing below is needed, and no rank waits for another.
        stale = bool(missing) or bool(holds and not renderers.is_compiled(plan))
        if not run.channel.maximum(stale):
            renderers.put(plan, received)
            return
        bricks = self._reader.load(run, plan, missing, holds)
        with run.collective("context", "context"):
            place = run.channel.placement()
        with run.local("context", "context"):
            if holds:
                renderers.open(plan, place.local_rank, run.options.device)
        with run.local("shaders", "shaders"):
            if holds:
                renderers.compile(plan)
        with run.local("upload", "load"):
            renderers.load(plan, bricks)
            renderers.put(plan, received)

    def take(self, plan: Plan, brick: Index, stored: Stored) -> None:
        """Store a brick from another rank; it is kept in memory until there is a renderer for the plan."""
        if self._renderers is not None and self._renderers.is_compiled(plan):
            self._renderers.put(plan, {brick: stored})
        else:
            self._received[brick] = stamp_of(plan, brick), stored

    @property
    def held(self) -> set[Index]:
        """Indices of the renderer's bricks, and of those that were read for it."""
        read = self._residency.held if self._residency else set()
        return read | self._renderers.bricks if self._renderers else set()

    def drop(self, bricks: Set[Index]) -> None:
        """Drop bricks that have changed."""
        if self._residency is not None:
            self._residency.drop(bricks)
        if self._renderers is not None:
            self._renderers.drop(bricks)

    def forget(self) -> None:
        """Forget what the last frame has found, so that the next one is drawn as a first one."""
        if self._renderers is not None:
            self._renderers.forget()

    def stored(self, bricks: Sequence[Index]) -> dict[Index, Stored]:
        """Return bricks of this rank, as they lie in GPU memory."""
        return self._renderers.stored(bricks) if self._renderers else {}

    def draw(
        self, run: Run, work: RankWork, tiles: Iterable[Rect] | None = None
    ) -> tuple[list[PartialImage], RankFrame]:
        """Draw this rank's pieces.

        Parameters
        ----------
        tiles : parts of the picture in which all pieces are drawn, one after the other, as from a work queue; None: the
            rectangles of the pieces

        Returns
        -------
        partials : partial images, front to back
        counts : of this rank
        """
        with run.local("render"):
            mine = work.pieces_of(run.channel.rank)
            pieces = mine if tiles is None else self._in_tiles(run, mine, tiles)
            self.sample_counts, self.fragments, self._pieces = [], [], mine if tiles is None else []
            if self._renderers is None or work.plan is None:
                return [], RankFrame({})
            passes = self._passes if tiles is None else None
            if passes:
                passes.begin(work.plan, mine)
            began, began_cpu = perf_counter(), process_time()
            pixel = work.scene.quality.pixel
            drawn = self._renderers.draw(work.plan, pieces, partial(_report, run.options), passes, pixel)
            counts = replace(self._counted(drawn), cpu_seconds=process_time() - began_cpu)
            if passes:
                run.clock.add("load", passes.seconds)
                counts = replace(counts, passes=passes.passes, brick_memory_bytes=passes.most_bytes)
            before, self._read = self._read, (self._reader.bricks_read, self._reader.bytes_read)
            counts = replace(counts, bricks_read=self._read[0] - before[0], bytes_read=self._read[1] - before[1])
            self.sample_counts = [(work.plan.on_screen(each.partial.rect), each.work) for each in drawn]
            self.fragments = [each.fragments for each in drawn]
            for each in drawn:
                began = run.clock.add_span("render", began, each.seconds_render)
                began = run.clock.add_span("readback", began, each.seconds_readback)
            return [each.partial for each in drawn], counts

    def find_layers(self, run: Run, work: RankWork, partials: Sequence[PartialImage]) -> list[FoundLayers]:
        """Find where the opacity of pixels passes one half, in the pieces drawn last; collective.

        It is that of each piece with pixels, see `as_partials`; nothing if the scene has no layers.
        """
        if work.plan is None or not work.plan.layers:
            return []
        from clusterviz.render.crossing import as_partials

        images = list(partials)
        if work.mode == "hybrid":
            images = [joined(partials)] if run.channel.rank in work.order else []
        with run.collective("render", "exchange"):
            fronts = [np.zeros(image.rgba.shape[:2], np.float32) for image in images]
            if work.mode != "sort-first":
                fronts = opacity_in_front(images, work.order, work.scene.image.size, run.channel)
        with run.local("render", "render"):
            if self._renderers is None:
                return []
            if work.mode == "hybrid":
                fronts = [fronts[0][image.rect.slices_in(images[0].rect)] for image in partials]
            if self._passes:
                self._passes.begin(work.plan, self._pieces)
            found = self._renderers.find_layers(work.plan, self._pieces, fronts, self._passes)
            return [as_partials(work.plan, image.rect, each) for image, each in zip(partials, found, strict=True)]

    def _in_passes(self, run: Run, work: RankWork, renderers: RendererCache) -> Residency | None:
        """Return what loads bricks as they are drawn; None if all of them are loaded before; collective."""
        plan, cluster = work.plan, work.scene.cluster
        limit = cluster.memory_limit
        if limit is None and self._most_bytes is None:
            with abort_on_failure(run.channel, run.frame, "load"):
                local_size = run.channel.placement().local_size
            self._most_bytes = int(HELD_SHARE_OF_MEMORY * memory().available_bytes / local_size)
        if plan is None or cluster.distribution == "dynamic" or not plan.has_passes:
            return None
        if work.mode != "sort-last" and plan.refraction is None:
            return None
        if self._residency is None:
            self._residency = Residency(self._reader, renderers, prefers_cpu(run.options.device))
        return self._residency.prepare(plan, work.holds, limit, self._most_bytes or 0)

    def _in_tiles(self, run: Run, pieces: Sequence[Piece], tiles: Iterable[Rect]) -> Iterator[Piece]:
        for tile in tiles:
            run.options.poll()
            for piece in pieces:
                self._pieces.append(replace(piece, rect=tile))
                yield self._pieces[-1]

    def release(self) -> None:
        """Free the renderer and its bricks."""
        if self._residency is not None:
            self._residency.close()
            self._residency = self._passes = None
        if self._renderers is not None:
            self._renderers.release()
            self._renderers = None

    def _received_for(self, plan: Plan, holds: Set[Index]) -> dict[Index, Stored]:
        """Return received bricks that are stored as this plan asks for and that this rank still needs."""
        received, self._received = self._received, {}
        return {
            brick: stored
            for brick, (stamp, stored) in received.items()
            if brick in holds and stamp == stamp_of(plan, brick)
        }

    def _counted(self, drawn: Sequence[RenderResult]) -> RankFrame:
        held = self._renderers.held if self._renderers else {}
        occluded = sum(each.occluded for each in drawn)
        bricks, samples = sum(each.bricks for each in drawn), sum(each.samples for each in drawn)
        read = [each for each in drawn if each.bytes_read]
        frame_coherence = all_counts(each.frame_coherence for each in drawn)
        return RankFrame(
            {},
            **held,
            bricks_drawn=bricks,
            bricks_occluded=occluded,
            samples=samples,
            readback_bytes=sum(each.bytes_read for each in read),
            readback_pixel=read[0].partial.rgba.dtype.name if read else "",
            frame_coherence=frame_coherence,
            early_discarding=all_counts(each.early_discarding for each in drawn),
            kbuffer=all_counts(each.kbuffer for each in drawn),
            cut_short=sum(each.cut_short for each in drawn),
        )


def _report(options: Options, done: float) -> None:
    options.progress("render", done)
    options.poll()
