"""Tile scheduler: hooks of sort-first and hybrid around drawing.

(estimated: pre-pass) -> assign -> (scheduled: start the queue) -> draw -> (temporal: learn the cost)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from clusterviz.comm import WorkQueue
from clusterviz.distribution.sort_first import SortFirst
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.run import Run
from clusterviz.frame.work import RankWork
from clusterviz.image.partial import Rect
from clusterviz.partition.screen import COARSE, CostMap, coarse_partition, coarse_plan, cost_map_of_blocks
from clusterviz.partition.screen.tiles import tile_counts
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.values import Scene


class TileScheduler:
    """Hooks of a loop whose ranks share the screen; every method is collective.

    `drawing`, `screen`: of the loop.
    """

    def __init__(self, drawing: Drawing, screen: SortFirst) -> None:
        self._drawing, self._screen = drawing, screen
        self._strategy = screen.tiling.settings.strategy
        self._queue: WorkQueue | None = None
        self._samples_estimate = 0

    def prepare(self, run: Run, scene: Scene, plan: Plan) -> None:
        """Measure the cost of tiles by a pre-pass with few rays, if the strategy is estimated."""
        if self._strategy != "estimated":
            return
        screen, rank = self._screen, run.channel.rank
        with run.local("plan", "plan"):
            work = RankWork(scene, plan, screen.assign(plan), screen.holds(rank), screen.mode)
        self._drawing.load(run, work)
        coarse = coarse_plan(plan)
        pieces = screen.pieces(coarse, coarse_partition(screen.tiling.partition(plan)))
        _, counts = self._drawing.draw(run, RankWork(scene, coarse, pieces, work.holds, screen.mode))
        self._samples_estimate = counts.samples
        screen.follow(self._cost(run, scene, COARSE))

    def before(self, run: Run, work: RankWork) -> Iterator[Rect] | None:
        """Start the queue of tiles, if the strategy is scheduled, and return those that this rank takes."""
        if work.plan is None or self._strategy != "scheduled":
            return None
        channel, groups = run.channel, self._screen.groups
        with run.local("plan", "plan"):
            tiles = self._screen.tiling.queue(work.plan)
        with run.collective("render", "exchange"):
            if self._queue is None:
                rows, columns = tile_counts(work.scene.image.size, self._screen.tiling.settings.side)
                group = next(number for number, members in enumerate(groups) if channel.rank in members)
                alone = len(groups) == channel.size
                self._queue = WorkQueue(channel, rows * columns, group, len(groups), alone)
            else:
                self._queue.start()
        return (tiles[number] for number in self._queue.take(len(tiles)))

    def counted(self, counts: RankFrame) -> RankFrame:
        """Add the samples of the pre-pass to the counts of a frame."""
        extra = self._samples_estimate
        return replace(counts, samples=counts.samples + extra, samples_estimate=extra) if extra else counts

    def after(self, run: Run, work: RankWork, costs: Sequence[RankFrame]) -> None:
        """Learn the cost of the frame, if the strategy is temporal."""
        if work.plan is not None and self._strategy == "temporal":
            self._screen.follow(self._cost(run, work.scene))

    def close(self) -> None:
        if self._queue is not None:
            self._queue.free()
            self._queue = None

    def _cost(self, run: Run, scene: Scene, scale: int = 1) -> CostMap:
        with run.collective("render", "exchange"):
            gathered = run.channel.allgather([each for each in self._drawing.sample_counts if each[1].any()])
        return cost_map_of_blocks(scene.image.size, [each for counts in gathered for each in counts], scale)
