"""Contract of distributions, which assign bricks to ranks.

A distribution is kept from frame to frame. It uses only values that are equal on all ranks, so that all ranks reach the
same decisions without communication.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from clusterviz.data.source import Index
from clusterviz.frame.work import Mode
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame


class Distribution(Protocol):
    """Assignment of bricks to ranks, frame by frame."""

    @property
    def mode(self) -> Mode:
        """How ranks share a frame: sort-last, unless groups of them share the screen."""
        ...

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """Return the pieces of a frame, front to back; at each pixel, each visible brick is in exactly one."""
        ...

    def holds(self, rank: int) -> frozenset[Index]:
        """Return the bricks that a rank must keep after the last `assign`; it may drop all others."""
        ...

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """Learn from the cost of a frame on each rank."""
        ...
