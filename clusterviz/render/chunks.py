"""A rank's bricks in as many boxes as the GPU's limits ask for, from front to back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import BrickBox, build_tree, front_to_back
from clusterviz.plan.plan import Plan


def chunks_of(box: BrickBox, plan: Plan, capacity: int) -> list[BrickBox]:
    """Cut a box of bricks into boxes of at most `capacity` visible bricks, ordered by the plan's view.

    Parameters
    ----------
    box : the rank's bricks
    capacity : bricks that fit in one buffer or texture; at least 1
    """
    cost = (plan.cost[box.slices] > 0).astype(np.float64)
    if not cost.any():
        return []
    count = -(-int(cost.sum()) // capacity)
    tree = build_tree(cost, count)
    while max(_bricks(cost, leaf.box) for leaf in tree.leaves) > capacity:
        count += 1
        tree = build_tree(cost, count)
    origin = np.array(box.begin_zyx[::-1]) * plan.layout.brick
    eye = None if plan.view.parallel else tuple(float(e) for e in np.array(plan.view.eye) - origin)
    order = front_to_back(tree, eye, plan.view.forward, plan.layout.brick)  # type: ignore[arg-type]
    return [_moved(tree.leaves[leaf].trimmed, box) for leaf in order if tree.leaves[leaf].cost > 0]


def _bricks(cost: NDArray[np.float64], box: BrickBox) -> int:
    return int(cost[box.slices].sum())


def _moved(inner: BrickBox, outer: BrickBox) -> BrickBox:
    """A box within a box, in the coordinates of the outer one's surroundings."""
    z, y, x = outer.begin_zyx
    begin, end = inner.begin_zyx, inner.end_zyx
    return BrickBox((begin[0] + z, begin[1] + y, begin[2] + x), (end[0] + z, end[1] + y, end[2] + x))
