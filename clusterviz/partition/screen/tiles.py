"""Partition of the screen among groups of ranks: the rectangles of each group, and tiles, also round robin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from math import gcd

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.plan.plan import Plan

Size = tuple[int, int]
Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class ScreenPartition:
    """Assignment of the picture's pixels to groups of ranks."""

    size: Size  # (width, height) of the picture
    # rectangles of each group; together they contain every pixel once. A group may have none
    rects: tuple[tuple[Rect, ...], ...]

    @property
    def groups(self) -> int:
        return len(self.rects)

    def owner(self) -> NDArray[np.int32]:
        """Return the group of each pixel, int32 (height, width)."""
        found = np.full(self.size[::-1], -1, np.int32)
        for group, rects in enumerate(self.rects):
            for rect in rects:
                found[rect.y_begin : rect.y_end, rect.x_begin : rect.x_end] = group
        return found


def tile_counts(size: Size, side: int) -> tuple[int, int]:
    """Return the (rows, columns) of square tiles that cover a picture."""
    return -(-size[1] // side), -(-size[0] // side)


def tile_rect(size: Size, side: int, row: int, column: int) -> Rect:
    """Return the pixels of one tile; the last of a row or column may have fewer."""
    x, y = column * side, row * side
    return Rect(x, y, min(x + side, size[0]), min(y + side, size[1]))


def partition_of_tiles(owner: Numbers, size: Size, side: int, groups: int) -> ScreenPartition:
    """Return the partition of a picture given by tiles; adjacent tiles of one group are joined into rectangles.

    `owner`: int64 (rows, columns), group of each tile.
    """
    rects: list[list[Rect]] = [[] for _ in range(groups)]
    above: dict[tuple[int, int, int], int] = {}
    for row, line in enumerate(owner.tolist()):
        runs = _runs(line)
        here: dict[tuple[int, int, int], int] = {}
        for run in runs:
            begin, end, group = run
            rect = Rect(begin * side, row * side, min(end * side, size[0]), min((row + 1) * side, size[1]))
            if run in above:
                here[run] = above[run]
                rects[group][here[run]] = rects[group][here[run]].unite(rect)
            else:
                here[run] = len(rects[group])
                rects[group].append(rect)
        above = here
    return ScreenPartition(size, tuple(map(tuple, rects)))


def _runs(line: list[int]) -> list[tuple[int, int, int]]:
    runs, begin = [], 0
    for value, same in groupby(line):
        end = begin + sum(1 for _ in same)
        runs.append((begin, end, value))
        begin = end
    return runs


RankGroups = tuple[tuple[int, ...], ...]


def rank_groups(ranks: int, groups: int) -> RankGroups:
    """Return groups of neighbouring ranks, which are likely to share a node; sizes differ by at most one."""
    edges = [number * ranks // groups for number in range(groups + 1)]
    return tuple(tuple(range(begin, end)) for begin, end in pairwise(edges))


Bools = NDArray[np.bool_]


def brick_rects(plan: Plan) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the bricks that are not empty, and the pixels whose rays may meet each.

    Returns
    -------
    bricks : int64 (n, 3), indices (z, y, x)
    rects : int64 (n, 4): x_begin, y_begin, x_end, y_end; empty ones are outside of the picture
    """
    bricks = np.argwhere(plan.cost > 0)
    begin, end = (
        np.stack([b[at + side] for b, at in zip(plan.layout.borders_zyx, bricks.T, strict=True)], axis=1).astype(float)
        for side in (0, 1)
    )
    return bricks, plan.view.footprints(begin[:, ::-1], end[:, ::-1])


def visible_bricks(plan: Plan, rects: Sequence[Rect]) -> Bools:
    """Return the bricks, not empty, that rays of these rectangles may meet: bool (bz, by, bx)."""
    bricks, footprints = brick_rects(plan)
    seen = np.zeros(len(bricks), bool)
    for rect in rects:
        seen |= (
            (np.maximum(footprints[:, 0], rect.x_begin) < np.minimum(footprints[:, 2], rect.x_end))
            & (np.maximum(footprints[:, 1], rect.y_begin) < np.minimum(footprints[:, 3], rect.y_end))
        )  # fmt: skip
    found = np.zeros(plan.cost.shape, bool)
    found[tuple(bricks[seen].T)] = True
    return found


GOLDEN = 0.381966  # fraction of the groups by which a row of tiles is shifted against the one before


def interleaved_tiles(size: Size, groups: int, side: int) -> ScreenPartition:
    """Return the static interleaved tiling.

    When to use: always possible at no cost; balanced if tiles are many and small. When not: small tiles make many
    rectangles, and each group needs nearly all data.

    Along rows are the groups in turn; each row is shifted by a number without a common divisor with theirs, so that
    they take turns along columns too, and neighbours are far apart in number.

    Reference: R. Hu, J. Foley: Parallel processing approaches to hidden-surface removal in image space, Computers &
    Graphics 9(3), 1985; M. Strengert 2010, section 5.2.3, static.
    """
    rows, columns = tile_counts(size, side)
    shift = next(n for n in range(max(1, round(GOLDEN * groups)), groups + 2) if gcd(n, groups) == 1)
    owner = (np.arange(columns) + shift * np.arange(rows)[:, None]) % groups
    return partition_of_tiles(owner, size, side, groups)
