"""What a rank has of the volume, and what it has to draw; all but its own bricks is the same on every rank."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import VolumeSummary
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.scene.complete import VolumeFacts
from clusterviz.scene.values import Scene

Bricks = dict[Index, NDArray[Any]]
"""Samples (z, y, x) by index."""


@dataclass(frozen=True)
class OpenedVolume:
    """A volume, ready to be planned for.

    Attributes
    ----------
    source : where its voxels are
    layout : how it is cut
    summary : what it holds
    held : bricks that this rank has read and may need, by index; not the same on every rank
    """

    source: Source
    layout: BrickLayout
    summary: VolumeSummary
    held: Bricks

    @property
    def facts(self) -> VolumeFacts:
        """What completing a scene needs to know."""
        grid, summary = self.source.grid, self.summary
        low, high = summary.value_range
        percentile_1, percentile_99 = summary.percentile(1.0), summary.percentile(99.0)
        return VolumeFacts(grid.shape_zyx, grid.spacing, grid.corners, low, high, percentile_1, percentile_99)


@dataclass(frozen=True)
class Share:
    """What one rank has to draw.

    Attributes
    ----------
    scene : completed
    plan : None where there is no volume
    pieces : the frame's partial images of all ranks, from front to back
    holds : the bricks that this rank needs before it can draw
    """

    scene: Scene
    plan: Plan | None
    pieces: tuple[Piece, ...]
    holds: frozenset[Index]

    @property
    def order(self) -> list[int]:
        """The ranks of the partial images, from front to back."""
        return [piece.rank for piece in self.pieces]

    def pieces_of(self, rank: int) -> list[Piece]:
        """What one rank draws, front to back."""
        return [piece for piece in self.pieces if piece.rank == rank]
