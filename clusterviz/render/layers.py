"""Division of a piece's bricks into layers from front to back, so that opaque layers hide those behind them.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2
(early ray termination), here for whole bricks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition import Piece, bounding_box, build_tree, front_to_back
from clusterviz.plan.plan import Plan

MOST_LAYERS = 64
LEAST_BRICKS = 2
"""Least bricks of a layer; each layer costs a test of all rays."""


def layers_of(plan: Plan, piece: Piece) -> list[Piece]:
    """Return the visible bricks of a piece in disjoint boxes, from front to back.

    There is only one layer if no ray ends early, or if the piece is a rectangle of the screen that shares its bricks
    with others.
    """
    members = piece.members(plan.cost > 0)
    count = min(MOST_LAYERS, len(members) // LEAST_BRICKS)
    if count < 2 or not plan.march.residual or plan.blend_mode.operator != "over" or piece.rect is not None:
        return [piece] if len(members) else []
    box = bounding_box(members)
    present = np.zeros(box.shape_zyx)
    present[tuple((members - box.begin_zyx).T)] = 1.0
    tree = build_tree(present, count)
    order = front_to_back(tree, plan.eye_in_bricks(box.begin_zyx), plan.view.forward)
    found = [np.argwhere(present[tree.leaves[leaf].box.slices]) + tree.leaves[leaf].box.begin_zyx for leaf in order]
    return [_piece(piece, bricks + box.begin_zyx) for bricks in found if len(bricks)]


def _piece(whole: Piece, bricks: NDArray[np.int64]) -> Piece:
    box = bounding_box(bricks)
    own = np.zeros(box.shape_zyx, bool)
    own[tuple((bricks - box.begin_zyx).T)] = True
    return Piece(whole.rank, box, own)
