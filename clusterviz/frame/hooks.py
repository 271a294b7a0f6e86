"""What goes on around drawing, where a distribution asks for more than to be dealt: one contract for all that do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from clusterviz.distribution.contract import Distribution
from clusterviz.distribution.sort_first import SortFirst
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.opening import Opened
from clusterviz.frame.run import Run
from clusterviz.frame.work import RankWork
from clusterviz.report.statistics import RankFrame


class DistributionHooks(Protocol):
    """Goes with a distribution from frame to frame; every method is collective."""

    def before(self, opened: Opened, work: RankWork) -> RankWork:
        """Before a frame is drawn: what to draw, as it was dealt or otherwise."""
        ...

    def counted(self, counts: RankFrame) -> RankFrame:
        """A frame's counts, with its own."""
        ...

    def after(self, work: RankWork, costs: Sequence[RankFrame]) -> None:
        """After it was drawn, and what it cost each rank is known."""
        ...

    def close(self) -> None:
        """Give back what it took."""
        ...


def hooks_of(run: Run, drawing: Drawing, distribution: Distribution, several: bool) -> DistributionHooks | None:
    """The one that a distribution needs, if any; bricks move only where more than one frame may come."""
    if isinstance(distribution, SortFirst):
        from clusterviz.distribution.tile_scheduler import TileScheduler

        return TileScheduler(run, drawing, distribution)
    if several:
        from clusterviz.distribution.dynamic import Dynamic
        from clusterviz.migration.driver import MigrationDriver

        if isinstance(distribution, Dynamic):
            return MigrationDriver(run, distribution, drawing)
    return None
