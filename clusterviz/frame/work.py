"""Work of a rank in a frame, and its result before compositing."""

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
    """Work of one rank in a frame; all but `holds` and `queued_tiles` is the same on every rank.

    Attributes
    ----------
    scene : completed
    plan : None if the scene has no volume
    pieces : of all ranks, from front to back
    holds : bricks that this rank needs to draw
    mode : sort-last, sort-first or hybrid; the tiles of different groups do not overlap
    queued_tiles : takes tiles from a work queue while this rank draws, each for all of its pieces; None without a queue
    """

    scene: Scene
    plan: Plan | None
    pieces: tuple[Piece, ...]
    holds: frozenset[Index]
    mode: Mode = "sort-last"
    queued_tiles: Callable[[], Iterator[Rect]] | None = None

    @property
    def order(self) -> list[int]:
        """Ranks of the partial images, from front to back; one image a rank unless the mode is sort-last."""
        ranks = [piece.rank for piece in self.pieces]
        return ranks if self.mode == "sort-last" else list(dict.fromkeys(ranks))

    def pieces_of(self, rank: int) -> Iterable[Piece]:
        """Pieces of one rank, front to back."""
        mine = [piece for piece in self.pieces if piece.rank == rank]
        if self.queued_tiles is None:
            return mine
        return (replace(piece, rect=tile) for tile in self.queued_tiles() for piece in mine)


@dataclass(frozen=True)
class DrawnFrame:
    """Frame of one rank before compositing.

    Attributes
    ----------
    number : of the frame
    work : that was drawn
    partials : partial images of this rank, front to back
    counts : costs of drawing on this rank
    infos : info of each volume
    accuracy : of the settings chosen for `quality.max_error`; None without it
    sharing : chosen mode; None if none was chosen
    changes : settings that are not used as given
    """

    number: int
    work: RankWork
    partials: list[PartialImage]
    counts: RankFrame
    infos: tuple[VolumeInfo, ...] = ()
    accuracy: Accuracy | None = None
    sharing: Sharing | None = None
    changes: tuple[Change, ...] = ()
