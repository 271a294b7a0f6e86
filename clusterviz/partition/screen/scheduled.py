"""Scheduled tiles: whoever is free takes the next tile from a queue.

When to use: nothing is known of the cost, or ranks differ in speed; it is even to within one tile. When not: groups
must hold what any tile may see, and the network must count quickly. Dear tiles go first, so that the last ones taken,
during which the others wait, are cheap.

References
----------
M. Kaplan, D. Greenberg: Parallel processing techniques for hidden surface removal, SIGGRAPH 1979; R. Graham: Bounds on
multiprocessing timing anomalies, SIAM Journal on Applied Mathematics 17(2), 1969 (the longest first).
"""

from __future__ import annotations

import numpy as np

from clusterviz.image.region import Rect
from clusterviz.partition.screen.cost_map import CostMap
from clusterviz.partition.screen.mosaic import tile_counts, tile_rect


def queue_of_tiles(expected: CostMap, side: int) -> tuple[Rect, ...]:
    """The picture's tiles in the order in which they are taken, the same on every rank.

    Parameters
    ----------
    expected : what parts of the picture should cost; tiles without any cost are left out
    side : of a tile, in pixels

    Returns
    -------
    tiles : the dearest first; of equal ones the upper, then the left
    """
    rows, columns = tile_counts(expected.size, side)
    tiles = [tile_rect(expected.size, side, row, column) for row in range(rows) for column in range(columns)]
    costs = np.array([expected.total(tile) for tile in tiles])
    return tuple(tiles[number] for number in np.argsort(-costs, kind="stable") if costs[number] > 0)
