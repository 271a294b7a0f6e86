"""Whether all ranks have come to the same decisions: they compute them from the same values, each for itself.

A processor that rounds otherwise, a library of another version or another file on one node would make ranks draw bricks
twice, or not at all, and nobody would notice but those who look at the picture. So checksums are compared in every
frame, before anything is composited: a few numbers from each rank.
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
    """Compare what a frame is to show, and who draws what of it; collective.

    Raises
    ------
    RankError
        On every rank: of a rank that differs from most.
    """
    if run.channel.size == 1:
        return
    with abort_on_failure(run.channel, run.frame, "compare"):
        scene = zlib.crc32(work.scene.model_dump_json().encode())
        told = run.channel.allgather_numbers([scene, digest_of(work.pieces)])
    check_equal(run, {"what is to be shown": told[:, 0].tolist(), "who draws what": told[:, 1].tolist()})


def check_equal(run: Run, told: Mapping[str, Sequence[int]]) -> None:
    """Refuse checksums that are not the same for all ranks.

    Parameters
    ----------
    told : by what they stand for; one a rank, known to all

    Raises
    ------
    RankError
        On every rank: of the first rank that differs from most.
    """
    for name, sums in told.items():
        usual = Counter(sums).most_common(1)[0][0]
        odd = [rank for rank, found in enumerate(sums) if found != usual]
        if odd:
            beside = "" if len(odd) == 1 else f" (and so do ranks {', '.join(map(str, odd[1:]))})"
            cause = f"decides otherwise than the other ranks {name}{beside}; {REMEDY}"
            raise mark_agreed(RankError(odd[0], run.frame, "compare", cause))


def digest_of(pieces: Sequence[Piece]) -> int:
    """A checksum (CRC-32) of pieces: their ranks, bricks and windows, in their order."""
    boxes = [(piece.rank, *piece.box.begin_zyx, *piece.box.end_zyx) for piece in pieces]
    windows = [(number, *_corners(piece.rect)) for number, piece in enumerate(pieces) if piece.rect]
    found = zlib.crc32(np.array(windows, np.int64).tobytes(), zlib.crc32(np.array(boxes, np.int64).tobytes()))
    for number, piece in enumerate(pieces):
        if piece.bricks is not None:
            found = zlib.crc32(np.packbits(piece.bricks).data, zlib.crc32(number.to_bytes(8, "little"), found))
    return found


def _corners(window: Rect) -> tuple[int, int, int, int]:
    return window.x_begin, window.y_begin, window.x_end, window.y_end
