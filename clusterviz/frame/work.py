"""Work of a rank in a frame, its results, and the check that all ranks plan the same work.

A CPU that rounds differently, or another version of a library or a file on one node, could make ranks draw a brick
twice or not at all. The picture would be wrong without an error. So ranks compare checksums of their decisions in every
frame, before they draw.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from clusterviz.comm import abort_on_failure, mark_agreed
from clusterviz.content.facts import Facts
from clusterviz.data.source import Index
from clusterviz.errors import ClustervizError, RankError
from clusterviz.frame.run import Image, Run
from clusterviz.image.partial import PartialImage, Rect
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.render.crossing import FoundLayers
from clusterviz.report.decisions import Accuracy, Change, Sharing
from clusterviz.report.statistics import FrameStatistics, RankFrame
from clusterviz.report.trace import Span
from clusterviz.scene.values import Scene

T = TypeVar("T")
SampleCounts = tuple[Rect, NDArray[np.uint32]]
"""Rectangle of a piece, and its samples as `RenderResult.work`."""
Mode = Literal["sort-last", "sort-first", "hybrid"]
REMEDY = "all ranks need the same files, libraries and kind of CPU"


@dataclass(frozen=True)
class RankWork:
    """Work of one rank in a frame; all but `holds` is the same on every rank.

    Attributes
    ----------
    scene : completed, with the settings that were chosen for the frame
    plan : None if the scene has no volume
    pieces : of all ranks, from front to back
    holds : bricks that this rank needs to draw
    mode : sort-last, sort-first or hybrid; the tiles of different groups do not overlap
    accuracy : of the settings chosen for `quality.max_error`; None without it
    sharing : chosen mode; None if none was chosen
    """

    scene: Scene
    plan: Plan | None
    pieces: tuple[Piece, ...]
    holds: frozenset[Index]
    mode: Mode = "sort-last"
    accuracy: Accuracy | None = None
    sharing: Sharing | None = None

    @property
    def order(self) -> list[int]:
        """Ranks of the partial images, from front to back; one image a rank unless the mode is sort-last."""
        ranks = [piece.rank for piece in self.pieces]
        return ranks if self.mode == "sort-last" else list(dict.fromkeys(ranks))

    def pieces_of(self, rank: int) -> list[Piece]:
        """Pieces of one rank, front to back."""
        return [piece for piece in self.pieces if piece.rank == rank]


@dataclass(frozen=True)
class DrawingRequest:
    """Drawing that planning asks for before it decides; what is found is not shown.

    Attributes
    ----------
    run : of the planning
    work : to draw
    loads : work whose bricks are loaded first; None: they are there
    stage : whose time all of the drawing is; "": it is timed like that of frames
    composited : whether the picture is asked for, too
    """

    run: Run
    work: RankWork
    loads: RankWork | None = None
    stage: str = ""
    composited: bool = False


@dataclass(frozen=True)
class DrawingResult:
    """What a rank has found as it drew what planning asked for.

    Attributes
    ----------
    sample_counts : of each piece
    seconds : of drawing
    image : on rank 0, if it is asked for
    """

    partials: list[PartialImage]
    counts: RankFrame
    sample_counts: list[SampleCounts]
    seconds: float
    image: Image | None = None


Planning = Generator[DrawingRequest, DrawingResult, T]
"""Planning that yields what is to be drawn, on all ranks alike, is sent what was found, and returns its decision."""


@dataclass(frozen=True)
class DrawnFrame:
    """Frame of one rank before compositing.

    Attributes
    ----------
    number : of the frame
    work : that was drawn
    partials : partial images of this rank, front to back
    counts : costs of drawing on this rank
    infos : info of each volume and entry of geometry
    changes : settings that are not used as given
    layers : what this rank found for other layers, see `Drawing.find_layers`
    fragments : of each partial image, as `RenderResult.fragments`
    sample_counts : of each piece
    painted : what a `Painter` adds to the picture, float32 (h, w, 4); None without it, and on ranks other than 0
    """

    number: int
    work: RankWork
    partials: list[PartialImage]
    counts: RankFrame
    infos: tuple[Facts, ...] = ()
    changes: tuple[Change, ...] = ()
    layers: Sequence[FoundLayers] = ()
    fragments: Sequence[NDArray[np.int32]] = ()
    painted: Image | None = None
    sample_counts: Sequence[SampleCounts] = ()


@dataclass(frozen=True)
class Rendered:
    """Rendered frame: picture, scene and costs.

    Attributes
    ----------
    image : float32 (h, w, 4), premultiplied, without background, an `Image` if the scene has other layers; None on
        ranks other than 0
    scene : completed
    statistics : of all ranks, on every rank
    spans : of this rank's trace; empty without `Options.trace`
    drawn : frame of this rank before compositing; None without `Options.keep_drawn`
    """

    image: Image | None
    scene: Scene
    statistics: FrameStatistics
    spans: tuple[Span, ...] = ()
    drawn: DrawnFrame | None = None


def check_consistency(run: Run, work: RankWork) -> None:
    """Compare the scene and the pieces of a frame among all ranks; collective.

    Raises
    ------
    RankError
        On every rank; names a rank that differs from most.
    """
    if run.channel.size == 1:
        return
    with abort_on_failure(run.channel, run.frame, "compare"):
        scene = zlib.crc32(work.scene.model_dump_json().encode())
        for layer in work.plan.content.volume_layers if work.plan else ():
            scene = zlib.crc32(layer.levels.levels.tobytes() if layer.levels else b"", scene)
        sums = run.channel.allgather_numbers([scene, digest_of(work.pieces)])
    check_equal(run, {"what is to be shown": sums[:, 0].tolist(), "who draws what": sums[:, 1].tolist()})


def check_cover(run: Run, work: RankWork) -> None:
    """Check that at each pixel each visible brick is in exactly one piece, and that its rank holds it; collective.

    In a tile, bricks that do not appear there need no piece. The tiles of a work queue are not checked, since they are
    not known in advance.

    Raises
    ------
    ClustervizError
        Names the first brick for which this is wrong, and its ranks.
    """
    if work.plan is None:
        return
    shown, whole = work.plan.cost > 0, Rect(0, 0, *work.plan.view.size)
    tiles: dict[Rect | None, list[Piece]] = {} if work.mode != "sort-last" else {None: []}
    for piece in work.pieces:
        if piece.rect != whole:
            tiles.setdefault(piece.rect, []).append(piece)
    with run.local("plan", "check"):
        for rect, pieces in tiles.items():
            count = np.zeros(shown.shape, np.int64)
            for piece in pieces:
                count[tuple(piece.members(shown).T)] += 1
            for z, y, x in np.argwhere((count > 1) | (shown & (count == 0) & (rect is None)))[:1].tolist():
                ranks = [piece.rank for piece in pieces if [z, y, x] in piece.members(shown).tolist()]
                drawn = f"drawn {len(ranks)} times, by ranks {ranks}" if ranks else "drawn by no rank"
                raise ClustervizError(f"visible brick {(z, y, x)} is {drawn}" + (f", in {rect}" if rect else ""))
        drawn_here = {
            tuple(brick) for piece in work.pieces_of(run.channel.rank) for brick in piece.members(shown).tolist()
        }
        if missing := sorted(drawn_here - work.holds):
            raise ClustervizError(f"rank {run.channel.rank} draws brick {missing[0]}, which it does not hold")


def check_equal(run: Run, checksums: Mapping[str, Sequence[int]]) -> None:
    """Refuse checksums, one for each rank by the name of a decision, that are not equal on all ranks.

    Raises
    ------
    RankError
        On every rank; names the first rank that differs from most.
    """
    for name, sums in checksums.items():
        usual = Counter(sums).most_common(1)[0][0]
        odd = [rank for rank, found in enumerate(sums) if found != usual]
        if odd:
            beside = "" if len(odd) == 1 else f" (and so do ranks {', '.join(map(str, odd[1:]))})"
            cause = f"decides otherwise than the other ranks {name}{beside}; {REMEDY}"
            raise mark_agreed(RankError(odd[0], run.frame, "compare", cause))


def digest_of(pieces: Sequence[Piece]) -> int:
    """CRC-32 of the ranks, bricks and rectangles of pieces, in their order."""
    boxes = [(piece.rank, *piece.box.begin_zyx, *piece.box.end_zyx) for piece in pieces]
    rects = [(number, *_corners(piece.rect)) for number, piece in enumerate(pieces) if piece.rect]
    found = zlib.crc32(np.array(rects, np.int64).tobytes(), zlib.crc32(np.array(boxes, np.int64).tobytes()))
    for number, piece in enumerate(pieces):
        if piece.bricks is not None:
            found = zlib.crc32(np.packbits(piece.bricks).data, zlib.crc32(number.to_bytes(8, "little"), found))
    return found


def _corners(rect: Rect) -> tuple[int, int, int, int]:
    return rect.x_begin, rect.y_begin, rect.x_end, rect.y_end
