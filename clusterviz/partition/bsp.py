"""Binary space partition over whole bricks by recursive bisection, balanced by a cost per brick.

The bricks of each rank form a box, so that partial images can be ordered for any eye. The tree is a pure function of
the costs: every rank builds the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.tree import BrickBox, BspTree, Index, Leaf, Node, Split

Costs = NDArray[np.float64]
SAME_COST = 1e-9  # relative; sums along different axes differ by rounding, which must not decide the plane


def build_tree(cost: Costs, ranks: int) -> BspTree:
    """Divide the bricks among the ranks by recursive bisection.

    A node of n ranks gives ⌊n/2⌋ of them to the side below its plane and the rest to the other. The plane is chosen by

    1. the smallest lower bound of the largest cost of a rank: on each side the mean cost of a rank, counting no more
       ranks than bricks with a cost, and at least the cost of the most expensive brick;
    2. the fewest ranks without bricks;
    3. the smallest mean cost of a rank on the costlier side;
    4. the longest axis, the plane nearest the middle, z before y before x.

    The tree is the same on every rank for the same costs.

    Reference: M. Berger, S. Bokhari: A partitioning strategy for nonuniform problems on multiprocessors, IEEE
    Transactions on Computers 36(5), 1987 (binary decomposition).

    `cost`: float64 (bz, by, bx), finite, not negative: cost of each brick; 0 for one that is not drawn. `ranks`: number
    of leaves; above the number of bricks some leaves are empty.
    """
    z, y, x = cost.shape
    return BspTree((z, y, x), ranks, _grow(np.asarray(cost, np.float64), BrickBox((0, 0, 0), (z, y, x)), 0, ranks))


def _grow(cost: Costs, box: BrickBox, first_rank: int, ranks: int) -> Node:
    if ranks == 1:
        return make_leaf(cost, box, first_rank)
    low_ranks = ranks // 2
    axis, plane = _best_plane(cost[box.slices], low_ranks, ranks - low_ranks)
    plane += box.begin_zyx[axis]
    low, high = halves(box, axis, plane)
    low_node = _grow(cost, low, first_rank, low_ranks)
    return Split(axis, plane, low_node, _grow(cost, high, first_rank + low_ranks, ranks - low_ranks))


def make_leaf(cost: Costs, box: BrickBox, rank: int) -> Leaf:
    """Return the leaf of a box."""
    return Leaf(rank, box, trim(cost, box), float(cost[box.slices].sum()))


def halves(box: BrickBox, axis: int, plane: int) -> tuple[BrickBox, BrickBox]:
    """Return the parts of a box before and behind a plane."""
    low = BrickBox(box.begin_zyx, _replaced(box.end_zyx, axis, plane))
    return low, BrickBox(_replaced(box.begin_zyx, axis, plane), box.end_zyx)


def trim(cost: Costs, box: BrickBox) -> BrickBox:
    """Return the bounding box of the bricks with a cost above 0."""
    filled = np.argwhere(cost[box.slices] > 0)
    if len(filled) == 0:
        return BrickBox((0, 0, 0), (0, 0, 0))
    begin, end = filled.min(axis=0) + box.begin_zyx, filled.max(axis=0) + box.begin_zyx + 1
    return BrickBox((int(begin[0]), int(begin[1]), int(begin[2])), (int(end[0]), int(end[1]), int(end[2])))


def _replaced(index: Index, axis: int, value: int) -> Index:
    z, y, x = (value if a == axis else old for a, old in enumerate(index))
    return z, y, x


@dataclass(frozen=True)
class _Plane:
    """Plane that cuts a box: `plane` of its `size` layers of bricks along `axis` lie below.

    `load` is the mean cost of a rank on the costlier side; `idle` is the number of ranks without bricks.
    """

    axis: int
    plane: int
    size: int
    load: float
    idle: int


def _best_plane(cost: Costs, low_ranks: int, high_ranks: int) -> tuple[int, int]:
    """Return (axis, layers below the plane) of the best plane in a box; a box that cannot be cut lies below."""
    planes = [plane for axis in range(3) for plane in _planes(cost, axis, low_ranks, high_ranks)]
    if not planes:
        return 0, cost.shape[0]
    dearest = float(cost.max())
    planes = _least(planes, lambda plane: max(plane.load, dearest))
    planes = _least(planes, lambda plane: plane.idle)
    planes = _least(planes, lambda plane: plane.load)
    best = min(planes, key=lambda plane: (-plane.size, abs(2 * plane.plane - plane.size)))
    return best.axis, best.plane


def _planes(cost: Costs, axis: int, low_ranks: int, high_ranks: int) -> Iterator[_Plane]:
    others = tuple(other for other in range(3) if other != axis)
    layer_costs, layer_bricks = cost.sum(axis=others), np.count_nonzero(cost, axis=others)
    low_costs, high_costs = np.cumsum(layer_costs), np.cumsum(layer_costs[::-1])[::-1]
    low_bricks, high_bricks = np.cumsum(layer_bricks), np.cumsum(layer_bricks[::-1])[::-1]
    for plane in range(1, cost.shape[axis]):
        low_busy, high_busy = min(low_ranks, int(low_bricks[plane - 1])), min(high_ranks, int(high_bricks[plane]))
        load = max(float(low_costs[plane - 1]) / max(1, low_busy), float(high_costs[plane]) / max(1, high_busy))
        yield _Plane(axis, plane, cost.shape[axis], load, low_ranks + high_ranks - low_busy - high_busy)


def _least(planes: list[_Plane], measure: Callable[[_Plane], float]) -> list[_Plane]:
    limit = min(map(measure, planes)) * (1 + SAME_COST)
    return [plane for plane in planes if measure(plane) <= limit]
