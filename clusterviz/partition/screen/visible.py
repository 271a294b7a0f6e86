"""Bricks that are visible in parts of the screen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.region import Rect
from clusterviz.plan.plan import Plan

Bools = NDArray[np.bool_]


def brick_rects(plan: Plan) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the bricks that are not empty, and the pixels whose rays may meet each.

    Returns
    -------
    bricks : int64 (n, 3), indices (z, y, x)
    rects : int64 (n, 4): x_begin, y_begin, x_end, y_end; empty ones are outside of the picture
    """
    bricks = np.argwhere(plan.cost > 0)
    begin, end = (
        np.stack([b[at + side] for b, at in zip(plan.layout.borders_zyx, bricks.T, strict=True)], axis=1).astype(float)
        for side in (0, 1)
    )
    return bricks, plan.view.footprints(begin[:, ::-1], end[:, ::-1])


def visible_bricks(plan: Plan, rects: Sequence[Rect]) -> Bools:
    """Return the bricks, not empty, that rays of these rectangles may meet: bool (bz, by, bx)."""
    bricks, footprints = brick_rects(plan)
    seen = np.zeros(len(bricks), bool)
    for rect in rects:
        seen |= (
            (np.maximum(footprints[:, 0], rect.x_begin) < np.minimum(footprints[:, 2], rect.x_end))
            & (np.maximum(footprints[:, 1], rect.y_begin) < np.minimum(footprints[:, 3], rect.y_end))
        )  # fmt: skip
    found = np.zeros(plan.cost.shape, bool)
    found[tuple(bricks[seen].T)] = True
    return found
