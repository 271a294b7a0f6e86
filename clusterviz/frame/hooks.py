"""Contract of the hooks that a distribution may have before and after drawing."""

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
    """Hooks of a distribution, kept from frame to frame; every method is collective."""

    def before(self, opened: Opened, work: RankWork) -> RankWork:
        """Return the work to draw: as assigned, or changed."""
        ...

    def counted(self, counts: RankFrame) -> RankFrame:
        """Add the hooks' own counts to those of a frame."""
        ...

    def after(self, work: RankWork, costs: Sequence[RankFrame]) -> None:
        """Use the costs of a drawn frame, one for each rank."""
        ...

    def close(self) -> None:
        """Free resources."""
        ...


def hooks_of(run: Run, drawing: Drawing, distribution: Distribution, several: bool) -> DistributionHooks | None:
    """Return the hooks of a distribution, or None; bricks migrate only if more than one frame may come."""
    if isinstance(distribution, SortFirst):
        from clusterviz.distribution.tile_scheduler import TileScheduler

        return TileScheduler(run, drawing, distribution)
    if several:
        from clusterviz.distribution.dynamic import Dynamic
        from clusterviz.migration.driver import MigrationDriver

        if isinstance(distribution, Dynamic):
            return MigrationDriver(run, distribution, drawing)
    return None
