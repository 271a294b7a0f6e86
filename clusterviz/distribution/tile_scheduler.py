"""Tile scheduler: hooks of sort-first and hybrid around drawing.

assign -> (estimated: pre-pass, assign again) -> (scheduled: start the queue) -> draw -> (temporal: learn the cost)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from clusterviz.comm import WorkQueue
from clusterviz.distribution.sort_first import SortFirst
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.opening import Opened
from clusterviz.frame.run import Run
from clusterviz.frame.work import RankWork
from clusterviz.image.region import Rect
from clusterviz.partition.screen import (
    COARSE,
    CostMap,
    ScreenPartition,
    coarse_partition,
    coarse_plan,
    cost_map_of_blocks,
)
from clusterviz.partition.screen.tiles import tile_counts
from clusterviz.report.statistics import RankFrame


class TileScheduler:
    """Hooks of a loop whose ranks share the screen; every method is collective.

    Parameters
    ----------
    run, drawing, screen : of the loop
    """

    def __init__(self, run: Run, drawing: Drawing, screen: SortFirst) -> None:
        self._run, self._drawing, self._screen = run, drawing, screen
        self._queue: WorkQueue | None = None
        self._samples_estimate = 0

    def before(self, opened: Opened, work: RankWork) -> RankWork:
        """Return the work as assigned, with tiles by a pre-pass, or with tiles from a queue."""
        strategy = self._screen.tiling.settings.strategy
        if work.plan is None or strategy not in ("estimated", "scheduled"):
            return work
        if strategy == "scheduled":
            return self._with_queue(work)
        coarse = coarse_plan(work.plan)
        partition = coarse_partition(self._screen.tiling.partition(work.plan))
        pieces = self._screen.pieces(coarse, partition)
        _, counts = self._drawing.draw(replace(work, plan=coarse, pieces=pieces))
        self._samples_estimate = counts.samples
        self._screen.follow(self._cost(work, COARSE))
        with self._run.local("plan", "plan"):
            pieces = self._screen.assign(work.plan)
            work = replace(work, pieces=pieces, holds=self._screen.holds(self._run.channel.rank))
        self._drawing.load(opened, work)
        return work

    def counted(self, counts: RankFrame) -> RankFrame:
        """Add the samples of the pre-pass to the counts of a frame."""
        extra = self._samples_estimate
        return replace(counts, samples=counts.samples + extra, samples_estimate=extra) if extra else counts

    def after(self, work: RankWork, costs: Sequence[RankFrame]) -> None:
        """Learn the cost of the frame, if the strategy is temporal."""
        if work.plan is not None and self._screen.tiling.settings.strategy == "temporal":
            self._screen.follow(self._cost(work))

    def close(self) -> None:
        """Free the queue."""
        if self._queue is not None:
            self._queue.free()
            self._queue = None

    def _cost(self, work: RankWork, scale: int = 1) -> CostMap:
        """Gather the samples of the last drawing from all ranks."""
        with self._run.collective("render", "exchange"):
            gathered = self._run.channel.allgather([each for each in self._drawing.sample_counts if each[1].any()])
        return cost_map_of_blocks(work.scene.image.size, [each for counts in gathered for each in counts], scale)

    def _with_queue(self, work: RankWork) -> RankWork:
        """Return work whose tiles are taken from a queue while it is drawn."""
        assert work.plan is not None, "there is something to draw"
        channel, groups = self._run.channel, self._screen.groups
        with self._run.local("plan", "plan"):
            tiles = self._screen.tiling.queue(work.plan)
        with self._run.collective("render", "exchange"):
            if self._queue is None:
                rows, columns = tile_counts(work.scene.image.size, self._screen.tiling.settings.side)
                group = next(number for number, members in enumerate(groups) if channel.rank in members)
                alone = len(groups) == channel.size
                self._queue = WorkQueue(channel, rows * columns, group, len(groups), alone)
            else:
                self._queue.start()
        queue = self._queue

        def queued_tiles() -> Iterator[Rect]:
            return (tiles[number] for number in queue.take(len(tiles)))

        whole = ScreenPartition(work.plan.view.size, ((Rect(0, 0, *work.plan.view.size),),) * len(groups))
        return replace(work, pieces=self._screen.pieces(work.plan, whole), queued_tiles=queued_tiles)
