"""Consistency check: all ranks must reach the same decisions, which each computes for itself.

A CPU that rounds differently, or another version of a library or a file on one node, could make ranks draw a brick
twice or not at all. The picture would be wrong without an error. So ranks compare checksums of their decisions in every
frame, before compositing.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from clusterviz.comm import abort_on_failure, mark_agreed
from clusterviz.errors import RankError
from clusterviz.frame.run import Run
from clusterviz.frame.work import RankWork
from clusterviz.image.region import Rect
from clusterviz.partition import Piece

REMEDY = "all ranks need the same files, libraries and kind of processor"


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
        sums = run.channel.allgather_numbers([scene, digest_of(work.pieces)])
    check_equal(run, {"what is to be shown": sums[:, 0].tolist(), "who draws what": sums[:, 1].tolist()})


def check_equal(run: Run, checksums: Mapping[str, Sequence[int]]) -> None:
    """Refuse checksums that are not equal on all ranks.

    Parameters
    ----------
    checksums : one for each rank, the same on every rank, by the name of the decision

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
