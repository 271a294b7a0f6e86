"""Which bricks a part of the screen may show: what a rank needs in order to draw its windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.region import Rect
from clusterviz.plan.plan import Plan

Bools = NDArray[np.bool_]


def brick_rects(plan: Plan) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The bricks that have something to show, and the pixels whose rays may meet each.

    Returns
    -------
    bricks : int64 (n, 3), indices (z, y, x)
    rects : int64 (n, 4): x_begin, y_begin, x_end, y_end; empty ones are outside of the picture
    """
    bricks = np.argwhere(plan.cost > 0)
    begin = (bricks * plan.layout.brick).astype(np.float64)
    end = np.minimum(begin + plan.layout.brick, np.array(plan.layout.cells_zyx))
    return bricks, plan.view.footprints(begin[:, ::-1], end[:, ::-1])


def bricks_seen(plan: Plan, windows: Sequence[Rect]) -> Bools:
    """Which bricks any ray of these windows may meet, of those that have something to show: bool (bz, by, bx)."""
    bricks, rects = brick_rects(plan)
    seen = np.zeros(len(bricks), bool)
    for window in windows:
        seen |= (
            (np.maximum(rects[:, 0], window.x_begin) < np.minimum(rects[:, 2], window.x_end))
            & (np.maximum(rects[:, 1], window.y_begin) < np.minimum(rects[:, 3], window.y_end))
        )  # fmt: skip
    found = np.zeros(plan.cost.shape, bool)
    found[tuple(bricks[seen].T)] = True
    return found
