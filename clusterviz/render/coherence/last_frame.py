"""What a ray caster remembers of its last frame, so that the rays of the next one start later.

What does not hold any more is forgotten: another transfer function, look, step or clipping plane, bricks that came or
went, a camera that jumped. Then rays start where they enter the volume. So does each ray in every sixteenth frame, tile
by tile: what is so thin that the last frame's rays passed it by would never be found by those that start behind it.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.region import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.plan import Plan
from clusterviz.render.coherence.reprojection import Box, is_coherent, projection_of, reproject

ALIKE = 4  # slabs between neighbouring hits on one surface
FRESH_TILE, FRESH_TILES = 32, 16
"""Pixels along the side of a tile whose rays start anew, one of so many in a frame."""
Bricks = tuple[BrickBox, bytes]


@dataclass(frozen=True)
class Found:
    """What the rays of one piece hit.

    Attributes
    ----------
    plan, rect : they were drawn by, and the pixels that they are
    hits : float32 (3, rows, columns), (x, y, z) in index space; NaN where a ray met nothing
    """

    plan: Plan
    rect: Rect
    hits: NDArray[np.float32]


class LastFrame:
    """The last frame of a ray caster."""

    def __init__(self) -> None:
        self._last: dict[Bricks, Found] = {}
        self._now: dict[Bricks, Found] = {}
        self._frame = 0

    def forget(self) -> None:
        """The bricks are others."""
        self._last, self._now = {}, {}

    def next_frame(self) -> None:
        """What was this frame is the last one."""
        self._last, self._now = self._now, {}
        self._frame += 1

    def arrays(self, plan: Plan, bricks: Bricks, rect: Rect, shape: tuple[int, int]) -> dict[str, NDArray[np.float32]]:
        """What the kernel reads and writes of a piece: by the names of the job's addresses.

        Parameters
        ----------
        bricks : those that are drawn, and the box around them
        shape : rows and columns in memory
        """
        starts, last = np.zeros(shape, np.float32), self._last.get(bricks)
        if last is not None and _still_holds(last.plan, plan):
            box = _box_of(plan, bricks[0])
            if is_coherent(last.plan.view, plan.view, box):
                starts = np.full(shape, np.inf, np.float32)
                reproject(
                    (last.plan.view, plan.view),
                    (last.rect, rect),
                    box,
                    ALIKE * plan.march.step_world,
                    last.hits,
                    starts,
                )
                self._check_some(starts, rect)
        hits = np.empty((3, *shape), np.float32)
        self._now[bricks] = Found(plan, rect, hits)
        return {"starts": starts, "hits": hits}

    def _check_some(self, starts: NDArray[np.float32], rect: Rect) -> None:
        """Have the rays of this frame's tiles of the picture start anew."""
        for row in range(rect.y_begin // FRESH_TILE, -(-rect.y_end // FRESH_TILE)):
            for column in range(rect.x_begin // FRESH_TILE, -(-rect.x_end // FRESH_TILE)):
                if (5 * row + column - self._frame) % FRESH_TILES == 0:
                    y, x = row * FRESH_TILE - rect.y_begin, column * FRESH_TILE - rect.x_begin
                    starts[max(y, 0) : y + FRESH_TILE, max(x, 0) : x + FRESH_TILE] *= -1.0


def depth_of(plan: Plan) -> NDArray[np.float64]:
    """The row (4,) by which a kernel finds view depths."""
    row: NDArray[np.float64] = projection_of(plan.view)[2]
    return row


def _still_holds(last: Plan, plan: Plan) -> bool:
    """Whether nothing but the camera is another; frames of which that is so share all else."""
    names = ("march", "look", "clip", "encoding", "transfer", "segments", "layout", "cost")
    return all(getattr(last, name) is getattr(plan, name) for name in names)


def _box_of(plan: Plan, box: BrickBox) -> Box:
    brick, cells = plan.layout.brick, plan.layout.cells_zyx
    begin: Any = tuple(float(b * brick) for b in box.begin_zyx[::-1])
    end: Any = tuple(float(min(e * brick, n)) for e, n in zip(box.end_zyx[::-1], cells[::-1], strict=True))
    return Box(begin, end)
