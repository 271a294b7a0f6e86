"""Who draws which part of the picture, as a value: what every way to share the screen comes down to."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.image.region import Rect

Size = tuple[int, int]
Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class Mosaic:
    """The picture, dealt to groups of ranks.

    Attributes
    ----------
    size : (width, height) of the picture
    windows : the rectangles of each group; all together hold every pixel once. A group may have none
    """

    size: Size
    windows: tuple[tuple[Rect, ...], ...]

    @property
    def groups(self) -> int:
        """How many share the screen."""
        return len(self.windows)

    def owner(self) -> NDArray[np.int32]:
        """The group of each pixel, int32 (height, width)."""
        found = np.full(self.size[::-1], -1, np.int32)
        for group, windows in enumerate(self.windows):
            for window in windows:
                found[window.y_begin : window.y_end, window.x_begin : window.x_end] = group
        return found


def tile_counts(size: Size, side: int) -> tuple[int, int]:
    """(rows, columns) of square tiles that hold a picture.

    Raises
    ------
    InputError
        A side below 1.
    """
    if side < 1:
        raise InputError("no tile", where="side", found=side, allowed="1 or more")
    return -(-size[1] // side), -(-size[0] // side)


def tile_rect(size: Size, side: int, row: int, column: int) -> Rect:
    """The pixels of one tile; the last of a row or column may have fewer."""
    x, y = column * side, row * side
    return Rect(x, y, min(x + side, size[0]), min(y + side, size[1]))


def mosaic_of(owner: Numbers, size: Size, side: int, groups: int) -> Mosaic:
    """Tiles as windows; neighbours of one group become one window where that is a rectangle.

    Parameters
    ----------
    owner : int64 (rows, columns), the group of each tile
    size, side : of the picture, and of the tiles

    Raises
    ------
    InputError
        Another number of tiles than the picture has, or a group that there is not.
    """
    if owner.shape != tile_counts(size, side):
        raise InputError("not the picture's tiles", where="owner", found=owner.shape, allowed=tile_counts(size, side))
    if owner.min() < 0 or owner.max() >= groups:
        raise InputError("no such group", where="owner", found=f"{owner.min()} … {owner.max()}", allowed=groups)
    windows: list[list[Rect]] = [[] for _ in range(groups)]
    above: dict[tuple[int, int, int], int] = {}
    for row, line in enumerate(owner.tolist()):
        runs = _runs(line)
        here: dict[tuple[int, int, int], int] = {}
        for run in runs:
            begin, end, group = run
            rect = Rect(begin * side, row * side, min(end * side, size[0]), min((row + 1) * side, size[1]))
            if run in above:
                here[run] = above[run]
                windows[group][here[run]] = windows[group][here[run]].unite(rect)
            else:
                here[run] = len(windows[group])
                windows[group].append(rect)
        above = here
    return Mosaic(size, tuple(map(tuple, windows)))


def _runs(line: list[int]) -> list[tuple[int, int, int]]:
    """(begin, end, value) of each run of equal values."""
    runs, begin = [], 0
    for value, same in groupby(line):
        end = begin + sum(1 for _ in same)
        runs.append((begin, end, value))
        begin = end
    return runs
