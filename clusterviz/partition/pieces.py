"""Pieces: the partial images of a frame from front to back, for any distribution.

Every rank lists the same pieces; each becomes one partial image of one rank. A slab is drawn by the piece that owns the
brick at its midpoint, in the pixels of its rectangle, so the picture does not depend on the pieces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition.bsp import Costs, trim
from clusterviz.partition.groups import visible_groups
from clusterviz.partition.owners import Owners
from clusterviz.partition.tree import BrickBox, BspTree, Vector, front_to_back


@dataclass(frozen=True, eq=False)
class Piece:
    """Bricks and pixels of one partial image."""

    rank: int  # rank that draws it
    box: BrickBox  # bounding box of its bricks
    bricks: NDArray[np.bool_] | None = None  # bool (bz, by, bx) over the box, its own bricks; None: all
    rect: Rect | None = None  # pixels to which it is clipped; None: the whole picture

    def shows_bricks_of(self, other: Piece) -> bool:
        """Return whether another piece has the same bricks, as the pieces of a shared screen do."""
        return self.box == other.box and self.bricks is other.bricks

    def part(self, bricks: NDArray[np.int64]) -> Piece:
        """Return the piece of some of its bricks, int64 (m, 3), m at least 1."""
        return replace(self, **_around(bricks))

    def members(self, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return its bricks that are shown, int64 (m, 3), indices (z, y, x); `shown` is bool over all bricks."""
        inside = shown[self.box.slices]
        return np.argwhere(inside if self.bricks is None else inside & self.bricks) + self.box.begin_zyx


def leaf_pieces(tree: BspTree, cost: Costs, eye_brick: Vector | None, direction_index: Vector) -> tuple[Piece, ...]:
    """Return a piece for each leaf with a cost above 0, from front to back.

    `cost`: float64 (bz, by, bx); may differ from the costs from which the tree was built.
    """
    order = front_to_back(tree, eye_brick, direction_index)
    boxes = [(rank, trim(cost, tree.leaves[rank].box)) for rank in order]
    return tuple(Piece(rank, box) for rank, box in boxes if box.bricks)


def owner_pieces(owners: Owners, eye_brick: Vector | None, direction_index: Vector) -> tuple[Piece, ...]:
    """Return a piece for each of the `visible_groups` of any assignment, from front to back."""
    groups = visible_groups(owners, eye_brick, direction_index)
    return tuple(Piece(group.rank, **_around(group.bricks)) for group in groups)


def _around(bricks: NDArray[np.int64]) -> dict[str, Any]:
    """Return the fields `box` and `bricks` of a piece."""
    box = bounding_box(bricks)
    own = np.zeros(box.shape_zyx, bool)
    own[tuple((bricks - box.begin_zyx).T)] = True
    return {"box": box, "bricks": None if own.all() else own}


def bounding_box(bricks: NDArray[np.int64]) -> BrickBox:
    """Return the bounding box of bricks, int64 (m, 3), m at least 1."""
    (z, y, x), (z_last, y_last, x_last) = bricks.min(axis=0).tolist(), bricks.max(axis=0).tolist()
    return BrickBox((z, y, x), (z_last + 1, y_last + 1, x_last + 1))
