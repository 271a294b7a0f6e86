"""A piece's bricks in layers from front to back, so that what is opaque saves those behind it.

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
"""A layer; each costs a look at all rays."""


def layers_of(plan: Plan, piece: Piece) -> list[Piece]:
    """The bricks of a piece that a plan shows, in boxes that do not meet, from front to back.

    All in one where no ray ends early, and where the piece is a window of bricks that other windows share.
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
