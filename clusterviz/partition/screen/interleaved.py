"""Static interleaved tiling: tiles assigned round robin, so that all groups share expensive regions."""

from __future__ import annotations

from math import gcd

import numpy as np

from clusterviz.partition.screen.tiles import ScreenPartition, Size, partition_of_tiles, tile_counts

GOLDEN = 0.381966  # fraction of the groups by which a row of tiles is shifted against the one before


def interleaved_tiles(size: Size, groups: int, side: int) -> ScreenPartition:
    """Return the static interleaved tiling.

    When to use: always possible at no cost; balanced if tiles are many and small. When not: small tiles make many
    rectangles, and each group needs nearly all data.

    Along rows are the groups in turn; each row is shifted by a number without a common divisor with theirs, so that
    they take turns along columns too, and neighbours are far apart in number.

    Reference: R. Hu, J. Foley: Parallel processing approaches to hidden-surface removal in image space, Computers &
    Graphics 9(3), 1985; M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart
    2010, section 5.2.3, static.
    """
    rows, columns = tile_counts(size, side)
    shift = next(n for n in range(max(1, round(GOLDEN * groups)), groups + 2) if gcd(n, groups) == 1)
    owner = (np.arange(columns) + shift * np.arange(rows)[:, None]) % groups
    return partition_of_tiles(owner, size, side, groups)
