"""One rank's part of the picture: the bricks that it needs brought to its GPU, its pieces drawn, and what that cost."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace
from functools import partial
from time import perf_counter, process_time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.frame.opening import Opened, load_bricks
from clusterviz.frame.run import Run
from clusterviz.frame.work import RankWork
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect
from clusterviz.render.stored_brick import stamp_of
from clusterviz.report.frame_coherence import together
from clusterviz.report.statistics import RankFrame

if TYPE_CHECKING:
    from clusterviz.plan.plan import Plan
    from clusterviz.render.render_result import RenderResult
    from clusterviz.render.renderer_cache import RendererCache
    from clusterviz.render.stored_brick import Stored


class Drawing:
    """What draws, from frame to frame; a rank that never has a brick starts no OpenGL.

    Parameters
    ----------
    run : of the loop

    Attributes
    ----------
    work : where this rank took how many samples when it drew last: the rectangle of each piece, and counts as
        `RenderResult.work`
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self._caster: RendererCache | None = None
        self.sample_counts: list[tuple[Rect, NDArray[np.uint32]]] = []
        self._taken: dict[Index, tuple[int, Stored]] = {}

    def bring(self, opened: Opened, work: RankWork) -> None:
        """Compile, read and upload what is not there; collective."""
        from clusterviz.render.renderer_cache import RendererCache

        run, plan, holds = self._run, work.plan, work.holds
        if plan is None:
            return
        caster = self._caster = self._caster or RendererCache(work.scene.cluster.memory_limit)
        caster.keep(holds)
        taken = self._taken_for(plan, holds)
        missing = caster.missing(plan, holds) - taken.keys()
        stale = bool(missing) or bool(holds and not caster.is_compiled(plan))
        if not run.channel.maximum(stale):
            caster.put(plan, taken)
            return
        bricks = load_bricks(run, opened, plan, missing, holds)
        with run.collective("context", "context"):
            place = run.channel.placement()
        with run.local("context", "context"):
            if holds:
                caster.open(plan, place.local_rank, run.options.device)
        with run.local("shaders", "shaders"):
            if holds:
                caster.compile(plan)
        with run.local("upload", "load"):
            caster.load(plan, bricks)
            caster.put(plan, taken)

    def take(self, plan: Plan, brick: Index, stored: Stored) -> None:
        """A brick that came from another rank, stored for a plan; kept for later where nothing could draw it yet."""
        if self._caster is not None and self._caster.is_compiled(plan):
            self._caster.put(plan, {brick: stored})
        else:
            self._taken[brick] = stamp_of(plan), stored

    def stored(self, bricks: Sequence[Index]) -> dict[Index, Stored]:
        """Bricks that are here, as they lie in GPU memory."""
        return self._caster.stored(bricks) if self._caster else {}

    def draw(self, work: RankWork) -> tuple[list[PartialImage], RankFrame]:
        """This rank's partial images, front to back."""
        run = self._run
        with run.local("render"):
            pieces = work.pieces_of(run.channel.rank)
            self.sample_counts = []
            if self._caster is None or work.plan is None:
                return [], RankFrame({})
            began, processor = perf_counter(), process_time()
            drawn = self._caster.draw(work.plan, pieces, partial(run.options.progress, "render"))
            counts = replace(self._counted(drawn), cpu_seconds=process_time() - processor)
            self.sample_counts = [(each.partial.rect, each.work) for each in drawn]
            for each in drawn:
                began = run.clock.add_span("render", began, each.seconds_render)
                began = run.clock.add_span("readback", began, each.seconds_readback)
            return [each.partial for each in drawn], counts

    def release(self) -> None:
        """Give everything back to the driver."""
        if self._caster is not None:
            self._caster.release()
            self._caster = None

    def _taken_for(self, plan: Plan, holds: Set[Index]) -> dict[Index, Stored]:
        """What came and is of use: stored as this plan asks for, and still to be held."""
        taken, self._taken = self._taken, {}
        asked = stamp_of(plan)
        return {brick: stored for brick, (stamp, stored) in taken.items() if brick in holds and stamp == asked}

    def _counted(self, drawn: Sequence[RenderResult]) -> RankFrame:
        held = self._caster.held if self._caster else {}
        occluded = sum(each.occluded for each in drawn)
        bricks, samples = sum(each.bricks for each in drawn), sum(each.samples for each in drawn)
        frame_coherence = together(each.frame_coherence for each in drawn)
        return RankFrame(
            {}, **held, bricks_drawn=bricks, bricks_occluded=occluded, samples=samples, frame_coherence=frame_coherence
        )
