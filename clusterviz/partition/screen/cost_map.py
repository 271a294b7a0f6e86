"""Cost map: measured or expected cost of each cell of a grid over the screen; a work queue of tiles by their cost.

From the queue an idle rank takes the next tile. When to use: the cost is not known, or ranks differ in speed; the
balance is exact to one tile. When not: groups must hold the data of all tiles, and the network needs fast atomic
counters. Expensive tiles come first, so that the last ones, for which the other ranks wait, are cheap.

Reference: M. Kaplan, D. Greenberg: Parallel processing techniques for hidden surface removal, SIGGRAPH 1979; R. Graham:
Bounds on multiprocessing timing anomalies, SIAM Journal on Applied Mathematics 17(2), 1969 (the longest first).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition.screen.tiles import Size, tile_counts, tile_rect

CELL = 16  # pixels along the side of a cell
BLOCK = 8  # pixels along the side of a block for which casters count samples
Costs = NDArray[np.float64]
Counts = NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class CostMap:
    """Cost of the cells of a grid over the screen."""

    size: Size  # (width, height) of the picture
    cost: Costs  # float64 (rows, columns), cost of squares of `CELL` pixels (cut at the far sides), uniform inside each

    def profile(self, rect: Rect, axis: int) -> Costs:
        """Return the cumulative cost of a rectangle along an axis (0: rows), float64 (n + 1,)."""
        rows = _shares(rect.y_begin, rect.y_end, self.size[1], len(self.cost))
        columns = _shares(rect.x_begin, rect.x_end, self.size[0], self.cost.shape[1])
        per_cell = (self.cost @ columns) if axis == 0 else (rows @ self.cost)
        begin, end, most = ((rect.y_begin, rect.y_end, self.size[1]), (rect.x_begin, rect.x_end, self.size[0]))[axis]
        edges = np.minimum(np.arange(len(per_cell) + 1) * CELL, most)
        before = np.interp(np.arange(begin, end + 1), edges, np.concatenate([[0.0], np.cumsum(per_cell)]))
        profile: Costs = before - before[0]
        return profile

    def total(self, rect: Rect) -> float:
        """Return the cost of a rectangle."""
        return float(self.profile(rect, 0)[-1])


def cost_map_of_rects(size: Size, rects: NDArray[np.int64], costs: Costs) -> CostMap:
    """Return the cost map of rectangles, the cost of each distributed evenly over it.

    `rects`: int64 (n, 4), x_begin, y_begin, x_end, y_end; empty ones are ignored.

    Notes
    -----
    Rectangles are widened to whole cells.
    """
    rows, columns = tile_counts(size, CELL)
    filled = (rects[:, 2] > rects[:, 0]) & (rects[:, 3] > rects[:, 1])
    rects, costs = rects[filled], costs[filled]
    left, top = rects[:, 0] // CELL, rects[:, 1] // CELL
    right, bottom = -(-rects[:, 2] // CELL), -(-rects[:, 3] // CELL)
    density = costs / ((right - left) * (bottom - top))
    # Each rectangle is four corners of a cumulative sum.
    corners = np.zeros((rows + 1, columns + 1))
    for y, x, sign in ((top, left, 1), (top, right, -1), (bottom, left, -1), (bottom, right, 1)):
        np.add.at(corners, (y, x), sign * density)
    return CostMap(size, np.maximum(0.0, corners.cumsum(0).cumsum(1)[:rows, :columns]))


def cost_map_of_blocks(size: Size, blocks: Iterable[tuple[Rect, Counts]], scale: int = 1, side: int = BLOCK) -> CostMap:
    """Return the cost map of a caster's counts of square blocks of pixels.

    Parameters
    ----------
    blocks : rectangles of a picture `scale` times as coarse, with the counts (rows, columns) of its blocks from the
        rectangle's corner on; counts of overlapping blocks are added
    scale : pixels of the picture along the side of a coarse pixel; both pictures have the same centre
    """
    cost = np.zeros(tile_counts(size, CELL))
    for rect, counts in blocks:
        rows = _overlaps(rect.y_begin, rect.y_end, counts.shape[0], size[1], scale, side)
        columns = _overlaps(rect.x_begin, rect.x_end, counts.shape[1], size[0], scale, side)
        cost += rows.T @ (counts * float(scale**2)) @ columns
    return CostMap(size, cost)


def _overlaps(begin: int, end: int, blocks: int, whole: int, scale: int, side: int) -> Costs:
    """Return the fraction of each block of an interval of the coarse picture in each cell: float64 (blocks, cells)."""
    coarse = np.minimum(begin + side * np.arange(blocks + 1), end)
    # Both pictures have the same centre; coarse pixels beyond the borders count at the borders.
    fine = np.clip(scale * coarse + (whole - scale * -(-whole // scale)) / 2, 0, whole)
    edges = np.minimum(np.arange(tile_counts((whole, 1), CELL)[1] + 1) * CELL, whole)
    first, last = fine[:-1, None], np.maximum(fine[1:, None], fine[:-1, None] + 1e-9)
    covered = np.minimum(edges[1:], last) - np.maximum(edges[:-1], first)
    shares: Costs = np.maximum(0.0, covered) / (last - first)
    return shares


def _shares(begin: int, end: int, whole: int, cells: int) -> Costs:
    """Return the fraction of each cell that an interval covers."""
    edges = np.minimum(np.arange(cells + 1) * CELL, whole)
    covered = np.minimum(edges[1:], end) - np.maximum(edges[:-1], begin)
    shares: Costs = np.maximum(0, covered) / np.diff(edges)
    return shares


def tile_queue(expected: CostMap, side: int) -> tuple[Rect, ...]:
    """Return the tiles of the picture in the order in which they are taken, the same on every rank.

    The most expensive come first; of equal ones the upper, then the left.

    `expected`: expected cost; tiles without any cost are left out.
    """
    rows, columns = tile_counts(expected.size, side)
    tiles = [tile_rect(expected.size, side, row, column) for row in range(rows) for column in range(columns)]
    costs = np.array([expected.total(tile) for tile in tiles])
    return tuple(tiles[number] for number in np.argsort(-costs, kind="stable") if costs[number] > 0)
