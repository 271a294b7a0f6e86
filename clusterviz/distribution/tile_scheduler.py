"""Tile scheduler: hooks of sort-first and hybrid around drawing.

(estimated: pre-pass) -> assign -> (scheduled: start the queue) -> draw -> (temporal: learn the cost)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from clusterviz.comm import WorkQueue
from clusterviz.distribution.sort_first import SortFirst
from clusterviz.frame.run import Run
from clusterviz.frame.work import DrawingRequest, DrawnFrame, Planning, RankWork, SampleCounts
from clusterviz.image.partial import Rect
from clusterviz.partition.screen import COARSE, CostMap, coarse_partition, coarse_plan, cost_map_of_blocks
from clusterviz.partition.screen.tiles import tile_counts
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.values import Scene


class TileScheduler:
    """Hooks of a loop whose ranks share the screen; every method is collective."""

    def __init__(self, screen: SortFirst) -> None:
        self._screen = screen
        self._strategy = screen.tiling.settings.strategy
        self._queue: WorkQueue | None = None
        self._samples_estimate = 0

    def prepare(self, run: Run, scene: Scene, plan: Plan) -> Planning[None]:
        """Measure the cost of tiles by a pre-pass with few rays, if the strategy is estimated."""
        if self._strategy != "estimated":
            return
        screen, rank = self._screen, run.channel.rank
        with run.local("plan", "plan"):
            work = RankWork(scene, plan, screen.assign(plan), screen.holds(rank), screen.mode)
        coarse = coarse_plan(plan)
        pieces = screen.pieces(coarse, coarse_partition(screen.tiling.partition(plan)))
        few = RankWork(scene, coarse, pieces, work.holds, screen.mode)
        drawn = yield DrawingRequest(run, few, loads=work)
        self._samples_estimate = drawn.counts.samples
        screen.follow(_cost(run, scene, drawn.sample_counts, COARSE))

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

    def after(self, run: Run, drawn: DrawnFrame, costs: Sequence[RankFrame]) -> None:
        """Learn the cost of the frame, if the strategy is temporal."""
        if drawn.work.plan is not None and self._strategy == "temporal":
            self._screen.follow(_cost(run, drawn.work.scene, drawn.sample_counts))

    def close(self) -> None:
        if self._queue is not None:
            self._queue.free()
            self._queue = None


def _cost(run: Run, scene: Scene, sample_counts: Sequence[SampleCounts], scale: int = 1) -> CostMap:
    with run.collective("render", "exchange"):
        gathered = run.channel.allgather([each for each in sample_counts if each[1].any()])
    return cost_map_of_blocks(scene.image.size, [each for counts in gathered for each in counts], scale)
