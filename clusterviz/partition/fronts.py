"""Fronts: partition surfaces that divide a layer of bricks, so that costs are balanced to a single brick.

A plane that moves by one brick transfers a whole layer. A front divides its layer by rows, and its last row by bricks,
so it can move by a few bricks. A step in the front could make rays leave a rank's bricks and return, which needs more
images. To avoid that, the part of a layer or row that is nearer to the eye goes to the nearer side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.bsp import Costs
from clusterviz.partition.owners import Owners
from clusterviz.partition.tree import BspTree, Index, Leaf, Node, Vector, leaves_below

RayOrigin = tuple[float, float, float]
"""Origin of the rays along (z, y, x) in bricks; ±inf for parallel rays."""
PARALLEL_ORIGIN: RayOrigin = (-np.inf, -np.inf, -np.inf)
"""Origin of parallel rays with positive direction along all axes."""


def ray_origin(eye_brick: Vector | None, direction_index: Vector) -> RayOrigin:
    """Return the origin of a camera's rays; parameters as in `front_to_back`."""
    if eye_brick is None:
        z, y, x = (-np.inf if towards >= 0 else np.inf for towards in direction_index[::-1])
    else:
        z, y, x = eye_brick[::-1]
    return z, y, x


def front_owners(tree: BspTree, cost: Costs, eye: RayOrigin = PARALLEL_ORIGIN) -> Owners:
    """Divide the bricks by the axes and ranks of a tree's nodes, at fronts instead of planes.

    When to use: costs are known well, and whole layers are expensive. When not: every rank needs a box.

    Returns the rank of every brick. At each node the cost of either side differs from its ranks' share by at most half
    the cost of a brick. From an eye outside the volume's extent along all axes, such as that of parallel rays, whole
    ranks can be ordered; from others some ranks need a few more images.

    Reference: M. Strengert 2010, section 5.3.6: the transfer of complete fronts of bricks is the drawback that
    non-uniform bricks reduce there.

    `tree`: tree whose axes and ranks are used; its planes are not. `eye`: ray origin for which the number of images is
    small; their order is right for every origin.
    """
    owner = np.empty(cost.size, np.int32)
    index = np.indices(cost.shape).reshape(3, -1)
    _divide(_Bricks(index, cost.ravel(), tree.shape_zyx), np.arange(cost.size), tree.root, eye, owner)
    return Owners(tree.ranks, owner.reshape(cost.shape))


@dataclass(frozen=True, eq=False)
class _Bricks:
    """All bricks in array order: `index` is int64 (3, bricks), that of each along (z, y, x)."""

    index: NDArray[np.int64]
    cost: Costs
    shape_zyx: Index

    def across(self, axis: int) -> list[int]:
        """Return the other axes, the one with more bricks first."""
        return sorted((side for side in range(3) if side != axis), key=lambda side: -self.shape_zyx[side])


def _divide(bricks: _Bricks, inside: NDArray[np.int64], node: Node, eye: RayOrigin, owner: NDArray[np.int32]) -> None:
    """Assign the bricks `inside` a node to the leaves below it."""
    if isinstance(node, Leaf):
        owner[inside] = node.rank
        return
    low, high = (sum(1 for _ in leaves_below(side)) for side in (node.low, node.high))
    below = _below(bricks, inside, node.axis_zyx, low / (low + high), eye)
    _divide(bricks, inside[below], node.low, eye, owner)
    _divide(bricks, inside[~below], node.high, eye, owner)


def _below(bricks: _Bricks, inside: NDArray[np.int64], axis: int, share: float, eye: RayOrigin) -> NDArray[np.bool_]:
    """Return the bricks below the front: layers, then rows of the next layer, then bricks of the next row."""
    below, left = np.zeros(len(inside), bool), np.arange(len(inside))
    wanted = share * float(bricks.cost[inside].sum())
    low_is_near, sides = True, [axis, *bricks.across(axis)]
    for side in sides:
        if len(left) == 0:
            break
        place = bricks.index[side, inside[left]]
        first, last = int(place.min()), int(place.max())
        near_low = side == axis or eye[side] <= (first + last + 1) / 2
        turn = place - first if near_low == low_is_near else last - place
        sums = np.bincount(turn, bricks.cost[inside[left]])
        ends = np.cumsum(sums)
        cut = int(np.searchsorted(ends - sums / 2 if side == sides[-1] else ends[:-1], wanted))
        below[left[turn < cut]] = True
        wanted -= float(sums[:cut].sum())
        left = left[turn == cut]
        if side == axis:
            low_is_near = eye[axis] <= first + cut + 0.5
    return below
