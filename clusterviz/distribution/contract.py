"""The contract of every distribution: which rank draws what in a frame, and what it must hold for that.

A distribution lasts from frame to frame. It decides from values that all ranks have alike, so that all decide alike
without asking each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from clusterviz.data.source import Index
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.report.statistics import RankFrame


class Distribution(Protocol):
    """How bricks are dealt to ranks."""

    def assign(self, plan: Plan) -> tuple[Piece, ...]:
        """The pieces of a frame, from front to back: every brick that the plan shows is in one at each pixel."""
        ...

    def holds(self, rank: int) -> frozenset[Index]:
        """The bricks that a rank must have to draw its pieces of the last deal; others that it has may go."""
        ...

    def learn(self, plan: Plan, costs: Sequence[RankFrame]) -> None:
        """After a frame: what it cost each rank."""
        ...
