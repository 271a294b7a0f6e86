"""Fronts: planes that divide the layer of bricks which they pass, so that costs come out even to a single brick.

Whole layers are a coarse grain: a plane that moves by one brick carries all of a layer. A front goes through its layer
row by row, and through its last row brick by brick, so it moves by a few bricks where a plane moves by hundreds. Such a
step would cost images, as rays could leave a rank's bricks and come back; but the part of a layer, and of a row, that
is nearer to the eye goes to the side that is nearer, and then they do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.bsp import Costs
from clusterviz.partition.edges import Edges, uniform_edges
from clusterviz.partition.order import Vector
from clusterviz.partition.owners import Owners
from clusterviz.partition.tree import BspTree, Leaf, Node, leaves_below

Place = tuple[float, float, float]
"""Where rays come from, along (z, y, x) in bricks; ±inf of parallel rays."""
AFAR: Place = (-np.inf, -np.inf, -np.inf)
"""The origin of parallel rays that run upwards along all axes."""


def eye_place(eye_index: Vector | None, direction_index: Vector, brick_cells: int) -> Place:
    """Where a camera's rays come from; parameters as of `front_to_back`."""
    if eye_index is None:
        z, y, x = (-np.inf if towards >= 0 else np.inf for towards in direction_index[::-1])
    else:
        z, y, x = (place / brick_cells for place in eye_index[::-1])
    return z, y, x


def front_owners(tree: BspTree, cost: Costs, eye: Place = AFAR, edges: Edges | None = None) -> Owners:
    """Divide the bricks as the nodes of a tree do, by their axes and ranks, at fronts instead of planes.

    When to use: costs are known well, and whole layers are dear. When not: every rank has to have a box.

    Parameters
    ----------
    tree : its axes and ranks count, and where its planes are does not
    cost : float64 (bz, by, bx); bricks without a cost go where their place is
    eye : from which images shall be few; their order is right from everywhere
    edges : between units of bricks that stay whole; single bricks where None

    Returns
    -------
    owners : of every brick, by the numbers of the tree's leaves. At each node the cost of either side is within that of
        half a unit of what its ranks' share is. From an eye that is past the volume's borders along all axes, as that
        of parallel rays, whole ranks can be ordered; from others some take a few images more

    Raises
    ------
    InputError
        The cost is over other bricks than the tree.

    References
    ----------
    M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 5.3.6:
    that a complete front of bricks is transferred is the drawback which non-uniform bricks lessen there.
    """
    if cost.shape != tree.shape_zyx:
        raise InputError("not over the tree's bricks", where="cost", found=cost.shape, allowed=tree.shape_zyx)
    lines = [_line(n, each) for n, each in zip(cost.shape, edges or uniform_edges(tree.shape_zyx), strict=True)]
    unit = np.stack([each.ravel() for each in np.meshgrid(*(number for number, _ in lines), indexing="ij")])
    middle = lines[0][1], lines[1][1], lines[2][1]
    owner = np.empty(cost.size, np.int32)
    _divide(_Bricks(unit, cost.ravel(), middle), np.arange(cost.size), tree.root, eye, owner)
    return Owners(tree.ranks, owner.reshape(cost.shape))


@dataclass(frozen=True, eq=False)
class _Bricks:
    """All bricks in array order.

    `unit` is int64 (3, bricks), the unit of each along (z, y, x), `middle` where the units of an axis are, in bricks.
    """

    unit: NDArray[np.int64]
    cost: Costs
    middle: tuple[Costs, Costs, Costs]

    def across(self, axis: int) -> list[int]:
        """The other axes, the one with more units first."""
        return sorted((side for side in range(3) if side != axis), key=lambda side: -len(self.middle[side]))


def _line(bricks: int, edges: tuple[int, ...]) -> tuple[NDArray[np.int64], Costs]:
    """The unit of each brick along an axis, and the middle of each unit."""
    borders = np.array([0, *edges, bricks])
    return np.searchsorted(borders[1:-1], np.arange(bricks), side="right"), (borders[1:] + borders[:-1]) / 2


def _divide(bricks: _Bricks, inside: NDArray[np.int64], node: Node, eye: Place, owner: NDArray[np.int32]) -> None:
    """Give the bricks `inside` a node to the leaves below it."""
    if isinstance(node, Leaf):
        owner[inside] = node.rank
        return
    low, high = (sum(1 for _ in leaves_below(side)) for side in (node.low, node.high))
    below = _below(bricks, inside, node.axis_zyx, low / (low + high), eye)
    _divide(bricks, inside[below], node.low, eye, owner)
    _divide(bricks, inside[~below], node.high, eye, owner)


def _below(bricks: _Bricks, inside: NDArray[np.int64], axis: int, share: float, eye: Place) -> NDArray[np.bool_]:
    """Which bricks are below the front: layers of units, then rows of the next layer, then units of the next row."""
    below, left = np.zeros(len(inside), bool), np.arange(len(inside))
    wanted = share * float(bricks.cost[inside].sum())
    low_is_near, sides = True, [axis, *bricks.across(axis)]
    for side in sides:
        if len(left) == 0:
            break
        place = bricks.unit[side, inside[left]]
        first, last, middle = int(place.min()), int(place.max()), bricks.middle[side]
        near_low = side == axis or eye[side] <= (middle[first] + middle[last]) / 2
        turn = place - first if near_low == low_is_near else last - place
        sums = np.bincount(turn, bricks.cost[inside[left]])
        ends = np.cumsum(sums)
        cut = int(np.searchsorted(ends - sums / 2 if side == sides[-1] else ends[:-1], wanted))
        below[left[turn < cut]] = True
        wanted -= float(sums[:cut].sum())
        left = left[turn == cut]
        if side == axis:
            low_is_near = eye[axis] <= middle[first + cut]
    return below
