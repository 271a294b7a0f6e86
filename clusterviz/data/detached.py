"""Data in files beside the header, as NRRD and MetaImage have them: numbered names, equal shares."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from clusterviz.data.header import check_size
from clusterviz.data.storage import Piece
from clusterviz.errors import DataError

MOST_FILES = 1 << 16
NUMBERED = re.compile(r"([^\s%]*%0?\d?\d?d[^\s%]*) +(-?\d+) +(-?\d+) +(-?\d+)( +\d+)?")


def numbered_names(entry: str, where: str) -> list[str]:
    """The files that `entry` names: those of "name%03d.raw first last step", or the one of this name.

    Raises
    ------
    DataError
        The step is 0, or there are more than `MOST_FILES`.
    """
    pattern = NUMBERED.fullmatch(entry)
    if not pattern:
        return [entry]
    first, last, step = (int(pattern[i]) for i in (2, 3, 4))
    numbers = range(first, last + (1 if step > 0 else -1), step or 1)
    if step == 0 or max(map(abs, (first, last, step))) >> 62 or len(numbers) > MOST_FILES:
        allowed = f"first, last and a step other than 0 for at most {MOST_FILES} files"
        raise DataError("impossible data file", where=where, found=entry, allowed=allowed)
    return [pattern[1] % number for number in numbers]


def raw_pieces(
    files: Sequence[Path], sizes: Sequence[int], begins: Sequence[int], skip: int, needed: int
) -> list[Piece]:
    """One piece a file; each must hold exactly its share, the samples being dealt evenly.

    Parameters
    ----------
    sizes, begins : bytes in each file, and before its data
    skip : further bytes before the data; −1: the data ends with the file
    needed : bytes in all pieces together
    """
    share = needed // len(files)
    pieces = []
    for file, size, begin in zip(files, sizes, begins, strict=True):
        start = size - share if skip == -1 else begin + skip
        check_size(size, start + share if start >= 0 else share, str(file), exact=True)
        pieces.append(Piece(file, start, share))
    check_size(share * len(files), needed, str(files[0]))
    return pieces
