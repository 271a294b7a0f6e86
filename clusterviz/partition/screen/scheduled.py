"""Work queue of screen tiles: an idle rank takes the next tile.

When to use: the cost is not known, or ranks differ in speed; the balance is exact to one tile. When not: groups must
hold the data of all tiles, and the network needs fast atomic counters. Expensive tiles come first, so that the last
ones, for which the other ranks wait, are cheap.

Reference: M. Kaplan, D. Greenberg: Parallel processing techniques for hidden surface removal, SIGGRAPH 1979; R. Graham:
Bounds on multiprocessing timing anomalies, SIAM Journal on Applied Mathematics 17(2), 1969 (the longest first).
"""

from __future__ import annotations

import numpy as np

from clusterviz.image.partial import Rect
from clusterviz.partition.screen.cost_map import CostMap
from clusterviz.partition.screen.tiles import tile_counts, tile_rect


def tile_queue(expected: CostMap, side: int) -> tuple[Rect, ...]:
    """Return the tiles of the picture in the order in which they are taken, the same on every rank.

    The most expensive come first; of equal ones the upper, then the left.

    `expected`: expected cost; tiles without any cost are left out.
    """
    rows, columns = tile_counts(expected.size, side)
    tiles = [tile_rect(expected.size, side, row, column) for row in range(rows) for column in range(columns)]
    costs = np.array([expected.total(tile) for tile in tiles])
    return tuple(tiles[number] for number in np.argsort(-costs, kind="stable") if costs[number] > 0)
