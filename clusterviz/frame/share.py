"""What a rank has of the volume, and what it has to draw; all but its own bricks is the same on every rank."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from clusterviz.data.bricks import BrickLayout, read_bricks
from clusterviz.data.grid import Grid
from clusterviz.data.source import Index, Source
from clusterviz.data.summary import VolumeSummary, block_sides
from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan, make_plan
from clusterviz.report.decisions import Accuracy, Change, Sharing
from clusterviz.report.statistics import RankFrame
from clusterviz.scene.complete import VolumeInfo
from clusterviz.scene.values import Scene

Mode = Literal["sort-last", "sort-first", "hybrid"]
Bricks = dict[Index, Any]
"""By index the samples (z, y, x) of one volume, or the `Portions` of several."""


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
    def grid(self) -> Grid:
        """In whose index space plans are."""
        return self.source.grid

    @property
    def facts(self) -> tuple[VolumeInfo, ...]:
        """What completing a scene needs to know."""
        grid, summary, known = self.source.grid, self.summary, self.summary.categories
        low, high = summary.value_range
        percentile_1, percentile_99 = summary.percentile(1.0), summary.percentile(99.0)
        more: dict[str, Any] = {}
        if known is not None and len(known.values):
            commonest, equal = int(known.equal[known.counts.argmax()]), int(known.equal.sum())
            more = {"values": known.values, "counts": known.counts}
            more["equal_share"] = (equal - commonest) / max(1, known.pairs - commonest)
            more["jump_share"] = known.jumps / max(1, known.pairs - equal)
        facts = VolumeInfo(
            grid.shape_zyx,
            grid.spacing,
            grid.corners,
            *(low, high, percentile_1, percentile_99),
            finite=int(summary.histogram.sum()),
            orientation=grid.orientation,
            is_integer=self.source.dtype.kind != "f",
            histogram=summary.histogram,
            blocks=summary.blocks,
            block_sides=block_sides(grid.shape_zyx),
            **more,
        )
        return (facts,)

    @property
    def range_type(self) -> np.dtype[Any]:
        """Of what is known of groups of cells: the voxels'."""
        return self.source.dtype

    def plan(self, scene: Scene) -> Plan:
        """One frame's decisions."""
        return make_plan(scene, self.source.grid, self.source.dtype, self.layout, self.summary)

    def read(self, plan: Plan, wanted: Set[Index]) -> Iterator[tuple[Index, Any]]:
        """Bricks of a plan, from the source."""
        return read_bricks(self.source, self.layout, wanted)

    def fitting(self, plan: Plan) -> Bricks:
        """What is held and was read as a plan asks for: all of it."""
        return self.held


@dataclass(frozen=True)
class Share:
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
    share: Share
    partials: list[PartialImage]
    counts: RankFrame
    facts: tuple[VolumeInfo, ...] = ()
    accuracy: Accuracy | None = None
    sharing: Sharing | None = None
    changes: tuple[Change, ...] = ()
