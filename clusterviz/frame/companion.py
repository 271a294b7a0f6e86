"""What goes on around drawing, where a distribution asks for more than to be dealt: one contract for all that do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from clusterviz.frame.distribution import Distribution
from clusterviz.frame.drawing import Drawing
from clusterviz.frame.run import Run
from clusterviz.frame.several import Opened
from clusterviz.frame.share import Share
from clusterviz.frame.shared_screen import SharedScreen
from clusterviz.report.statistics import RankFrame


class Companion(Protocol):
    """Goes with a distribution from frame to frame; every method is collective."""

    def before(self, opened: Opened, share: Share) -> Share:
        """Before a frame is drawn: what to draw, as it was dealt or otherwise."""
        ...

    def counted(self, counts: RankFrame) -> RankFrame:
        """A frame's counts, with its own."""
        ...

    def after(self, share: Share, costs: Sequence[RankFrame]) -> None:
        """After it was drawn, and what it cost each rank is known."""
        ...

    def close(self) -> None:
        """Give back what it took."""
        ...


def companion_of(run: Run, drawing: Drawing, distribution: Distribution, several: bool) -> Companion | None:
    """The one that a distribution needs, if any; bricks move only where more than one frame may come."""
    if isinstance(distribution, SharedScreen):
        from clusterviz.frame.turns import Turns

        return Turns(run, drawing, distribution)
    if several:
        from clusterviz.frame.dynamic import Dynamic
        from clusterviz.frame.moving import Moving

        if isinstance(distribution, Dynamic):
            return Moving(run, distribution, drawing)
    return None
