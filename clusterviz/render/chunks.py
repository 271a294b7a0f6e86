"""Division of a rank's bricks into groups within the GPU's limits, compact so that few parts have to be drawn."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from clusterviz.partition import build_tree
from clusterviz.partition.pieces import bounding_box

Index = tuple[int, int, int]


def chunks_of(bricks: Collection[Index], capacity: int) -> list[list[Index]]:
    """Divide bricks into groups of at most `capacity` ≥ 1; the box around a group contains no brick of another."""
    if len(bricks) <= capacity:
        return [sorted(bricks)] if bricks else []
    indices = np.array(sorted(bricks), np.int64)
    box = bounding_box(indices)
    present = np.zeros(box.shape_zyx)
    present[tuple((indices - box.begin_zyx).T)] = 1.0
    count = -(-len(bricks) // capacity)
    tree = build_tree(present, count)
    while max(leaf.cost for leaf in tree.leaves) > capacity:
        count += 1
        tree = build_tree(present, count)
    found = [np.argwhere(present[leaf.box.slices]) + leaf.box.begin_zyx + box.begin_zyx for leaf in tree.leaves]
    return [[(int(z), int(y), int(x)) for z, y, x in chunk] for chunk in found if len(chunk)]
