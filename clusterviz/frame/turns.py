"""What a shared screen needs around drawing: a pre-pass before it, a queue while it lasts, and costs to follow after.

deal -> (estimated: the pre-pass, and deal again) -> (scheduled: start the queue) -> draw -> (temporal: tell the cost)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from clusterviz.comm import WorkQueue
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.share import Share
from clusterviz.frame.shared_screen import SharedScreen
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


class Turns:
    """The turns of a loop whose screen is shared; every method is collective.

    Parameters
    ----------
    run, drawing, screen : of the loop
    """

    def __init__(self, run: Run, drawing: Drawing, screen: SharedScreen) -> None:
        self._run, self._drawing, self._screen = run, drawing, screen
        self._queue: WorkQueue | None = None
        self._samples_estimate = 0

    def before(self, opened: Opened, share: Share) -> Share:
        """What to draw: as it was dealt, or as a pre-pass shows to be better, or as a queue gives it."""
        strategy = self._screen.tiling.settings.strategy
        if share.plan is None or strategy not in ("estimated", "scheduled"):
            return share
        if strategy == "scheduled":
            return self._with_queue(share)
        coarse = coarse_plan(share.plan)
        windows = coarse_partition(self._screen.tiling.mosaic(share.plan))
        pieces = self._screen.pieces(coarse, windows)
        _, counts = self._drawing.draw(replace(share, plan=coarse, pieces=pieces))
        self._samples_estimate = counts.samples
        self._screen.follow(self._cost(share, COARSE))
        with self._run.alone("plan", "plan"):
            pieces = self._screen.deal(share.plan)
            share = replace(share, pieces=pieces, holds=self._screen.holds(self._run.channel.rank))
        self._drawing.bring(opened, share)
        return share

    def counted(self, counts: RankFrame) -> RankFrame:
        """The counts of a frame with those of its pre-pass."""
        extra = self._samples_estimate
        return replace(counts, samples=counts.samples + extra, samples_estimate=extra) if extra else counts

    def after(self, share: Share, costs: Sequence[RankFrame]) -> None:
        """Follow what the frame cost."""
        if share.plan is not None and self._screen.tiling.settings.strategy == "temporal":
            self._screen.follow(self._cost(share))

    def close(self) -> None:
        """Give the queue back."""
        if self._queue is not None:
            self._queue.free()
            self._queue = None

    def _cost(self, share: Share, scale: int = 1) -> CostMap:
        """What all ranks counted when they drew last."""
        with self._run.together("render", "exchange"):
            told = self._run.channel.allgather([each for each in self._drawing.work if each[1].any()])
        return cost_map_of_blocks(share.scene.image.size, [each for counted in told for each in counted], scale)

    def _with_queue(self, share: Share) -> Share:
        """Tiles that are taken while they are drawn."""
        assert share.plan is not None, "there is something to draw"
        channel, groups = self._run.channel, self._screen.groups
        with self._run.alone("plan", "plan"):
            tiles = self._screen.tiling.queue(share.plan)
        with self._run.together("render", "exchange"):
            if self._queue is None:
                rows, columns = tile_counts(share.scene.image.size, self._screen.tiling.settings.side)
                group = next(number for number, members in enumerate(groups) if channel.rank in members)
                alone = len(groups) == channel.size
                self._queue = WorkQueue(channel, rows * columns, group, len(groups), alone)
            else:
                self._queue.start()
        queue = self._queue

        def windows() -> Iterator[Rect]:
            return (tiles[number] for number in queue.take(len(tiles)))

        whole = ScreenPartition(share.plan.view.size, ((Rect(0, 0, *share.plan.view.size),),) * len(groups))
        return replace(share, pieces=self._screen.pieces(share.plan, whole), windows=windows)
