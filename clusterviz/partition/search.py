"""Bounded search for the best-balanced BSP tree, and moving the planes of a given tree.

`build_tree` halves the ranks at each node by the locally best plane. With few layers of bricks, or a cost in one
corner, the ranks then have unequal costs. If few ranks remain, trying other axes and divisions is cheap and finds
better trees.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.bsp import SAME_COST, Costs, build_tree, halves, make_leaf
from clusterviz.partition.tree import BrickBox, BspTree, Leaf, Node, Split

FEW_RANKS = 8  # up to this number of ranks all divisions are tried
GOOD_ENOUGH = 1.005  # largest over mean cost of a node's ranks at which the search stops
TRIALS = 4  # cuts of a node of few ranks that are searched to the leaves


@dataclass(frozen=True, eq=False)
class CostTable:
    """Summed-volume table of the costs of bricks: `corner` (bz + 1, by + 1, bx + 1) sums all bricks before a corner."""

    cost: Costs
    corner: NDArray[np.float64]

    @staticmethod
    def of(cost: Costs) -> CostTable:
        """Return the table of a cost per brick."""
        corner = np.zeros(tuple(n + 1 for n in cost.shape))
        corner[1:, 1:, 1:] = cost.cumsum(0).cumsum(1).cumsum(2)
        return CostTable(cost, corner)

    def total(self, box: BrickBox) -> float:
        """Return the cost of a box."""
        return float(self.below(box, 0, np.array([box.end_zyx[0]]))[0])

    def planes(self, box: BrickBox, axis: int) -> NDArray[np.int64]:
        """Return the positions at which planes may cut a box."""
        return np.arange(box.begin_zyx[axis] + 1, box.end_zyx[axis])

    def below(self, box: BrickBox, axis: int, planes: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the cost of the parts of a box before planes across an axis."""
        begin, end = box.begin_zyx, box.end_zyx
        first, second = (other for other in range(3) if other != axis)
        lines = np.moveaxis(self.corner, axis, 0)
        sums = (
            lines[:, end[first], end[second]]
            - lines[:, begin[first], end[second]]
            - lines[:, end[first], begin[second]]
            + lines[:, begin[first], begin[second]]
        )
        costs: NDArray[np.float64] = np.maximum(0.0, sums[planes] - sums[begin[axis]])
        return costs


@dataclass(frozen=True)
class _Cut:
    """Cut of a box: `low_ranks` of its ranks lie before `plane`; `load` is the mean cost on the costlier side."""

    load: float
    length: int
    axis: int
    plane: int
    low_ranks: int


def search_tree(cost: Costs, ranks: int) -> BspTree:
    """Divide the bricks among the ranks, minimizing the largest cost of a rank by a bounded search.

    A node of more than `FEW_RANKS` ranks is halved where its halves are most even. With fewer ranks, the best cut of
    each axis and each division of the ranks is a candidate; the `TRIALS` most even ones are searched to the leaves,
    unless a bound excludes them.

    `cost`, `ranks`: as in `build_tree`. The tree is the same on every rank for the same costs; the largest cost is at
    most that of `build_tree`.
    """
    plain = build_tree(cost, ranks)
    if not cost.any():
        return plain
    table = CostTable.of(cost)
    # Without a limit the first trial of every node succeeds.
    root = _best(table, BrickBox((0, 0, 0), plain.shape_zyx), 0, ranks, np.inf) or plain.root
    found = BspTree(plain.shape_zyx, ranks, root)
    return plain if busiest(plain.root) < busiest(root) else found


def move_planes(tree: BspTree, cost: Costs) -> BspTree:
    """Move the planes of a tree to where the costs are most even now, from the root down.

    `cost`: as in `build_tree`.

    Reference: S. Marchesin, C. Mongenet, J.-M. Dischler: Dynamic load balancing for parallel volume rendering, EGPGV
    2006; C. Müller, M. Strengert, T. Ertl: Optimized volume raycasting for graphics-hardware-based cluster systems,
    EGPGV 2006.
    """
    table = CostTable.of(cost)
    return BspTree(tree.shape_zyx, tree.ranks, _moved(table, tree.root, BrickBox((0, 0, 0), tree.shape_zyx)))


def busiest(node: Node) -> float:
    """Return the largest cost of a leaf."""
    return node.cost if isinstance(node, Leaf) else max(busiest(node.low), busiest(node.high))


def _best(table: CostTable, box: BrickBox, first_rank: int, ranks: int, limit: float) -> Node | None:
    if ranks == 1:
        leaf = make_leaf(table.cost, box, first_rank)
        return leaf if leaf.cost < limit else None
    best, enough = None, GOOD_ENOUGH * table.total(box) / ranks
    trials = TRIALS if ranks <= FEW_RANKS else 1
    for cut in sorted(_cuts(table, box, ranks), key=lambda cut: (cut.load, -cut.length, cut.axis))[:trials]:
        if cut.load >= limit * (1 - SAME_COST):
            break
        low_box, high_box = halves(box, cut.axis, cut.plane)
        low = _best(table, low_box, first_rank, cut.low_ranks, limit)
        high = low and _best(table, high_box, first_rank + cut.low_ranks, ranks - cut.low_ranks, limit)
        if low is None or high is None:
            continue
        best = Split(cut.axis, cut.plane, low, high)
        limit = busiest(best)
        if limit <= enough:
            break
    return best


def _cuts(table: CostTable, box: BrickBox, ranks: int) -> Iterator[_Cut]:
    """Return the most even plane of each axis and division of ranks; a box without planes goes to the low side."""
    divisions = range(1, ranks) if ranks <= FEW_RANKS else (ranks // 2,)
    total, cuttable = table.total(box), False
    for axis in range(3):
        planes = table.planes(box, axis)
        if len(planes) == 0:
            continue
        cuttable = True
        below = table.below(box, axis, planes)
        for low_ranks in divisions:
            load = np.maximum(below / low_ranks, (total - below) / (ranks - low_ranks))
            at = int(np.argmin(load))
            yield _Cut(float(load[at]), box.shape_zyx[axis], axis, int(planes[at]), low_ranks)
    if not cuttable:
        yield _Cut(total / ranks, 0, 0, box.end_zyx[0], ranks // 2)


def _moved(table: CostTable, node: Node, box: BrickBox) -> Node:
    if isinstance(node, Leaf):
        return make_leaf(table.cost, box, node.rank)
    axis, planes = node.axis_zyx, table.planes(box, node.axis_zyx)
    plane = min(max(node.plane, box.begin_zyx[axis]), box.end_zyx[axis])
    if len(planes):
        share = _ranks(node.low) / (_ranks(node.low) + _ranks(node.high))
        total = table.total(box)
        below = table.below(box, axis, planes)
        load = np.maximum(below / share, (total - below) / (1 - share))
        old = np.flatnonzero(planes == node.plane)
        if len(old) == 0 or load[old[0]] > load.min():
            plane = int(planes[np.argmin(load)])
    low, high = halves(box, axis, plane)
    return Split(axis, plane, _moved(table, node.low, low), _moved(table, node.high, high))


def _ranks(node: Node) -> int:
    return 1 if isinstance(node, Leaf) else _ranks(node.low) + _ranks(node.high)
