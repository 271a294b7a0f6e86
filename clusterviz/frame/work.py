"""What a rank has of the volume, and what it has to draw; all but its own bricks is the same on every rank."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

from clusterviz.data.source import Index
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.report.decisions import Accuracy, Change, Sharing
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.complete import VolumeInfo
from clusterviz.scene.values import Scene

Mode = Literal["sort-last", "sort-first", "hybrid"]


@dataclass(frozen=True)
class RankWork:
    """What one rank has to draw.

    Attributes
    ----------
    scene : completed
    plan : None where there is no volume
    pieces : the frame's partial images of all ranks, from front to back
    holds : the bricks that this rank needs before it can draw
    mode : sort-last, or how the screen is shared: then windows of different groups do not overlap
    windows : where nobody knows before who draws what: the windows that this rank takes while it draws, each for all of
        its pieces
    """

    scene: Scene
    plan: Plan | None
    pieces: tuple[Piece, ...]
    holds: frozenset[Index]
    mode: Mode = "sort-last"
    windows: Callable[[], Iterator[Rect]] | None = None

    @property
    def order(self) -> list[int]:
        """The ranks of the partial images, from front to back; where the screen is shared, one image a rank."""
        ranks = [piece.rank for piece in self.pieces]
        return ranks if self.mode == "sort-last" else list(dict.fromkeys(ranks))

    def pieces_of(self, rank: int) -> Iterable[Piece]:
        """What one rank draws, front to back."""
        mine = [piece for piece in self.pieces if piece.rank == rank]
        if self.windows is None:
            return mine
        return (replace(piece, rect=window) for window in self.windows() for piece in mine)


@dataclass(frozen=True)
class DrawnFrame:
    """What one rank has of a frame before compositing.

    Attributes
    ----------
    number : of the frame
    partials : of this rank, front to back
    counts : what they cost it
    facts : of each volume
    accuracy : of settings that were chosen for it; None where the scene names them
    sharing : by the ranks; None where that was not asked for
    changes : settings that are not used as given
    """

    number: int
    work: RankWork
    partials: list[PartialImage]
    counts: RankFrame
    facts: tuple[VolumeInfo, ...] = ()
    accuracy: Accuracy | None = None
    sharing: Sharing | None = None
    changes: tuple[Change, ...] = ()
