"""Hits of a ray caster's last frame, which let the rays of the next one start later.

They are discarded if the transfer function, blend mode, step or clipping planes change, if bricks come or go, or if the
camera jumps. Then rays start where they enter the volume. So do the rays of blocks chosen at random, as rays that start
behind a thin feature which the last frame missed would never find it. If one of them has found something, all rays
around it start at their entry for some frames.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.region import Rect
from clusterviz.partition import BrickBox
from clusterviz.plan.plan import Plan
from clusterviz.render.coherence.reprojection import Box, is_coherent, project, projection_of, reproject
from clusterviz.report.frame_coherence import BLOCK, BLOCKS, VISIBLE, FrameCoherence

SMOOTH = 4  # most slabs between neighbouring hits on one surface
SUSPECTED = 16  # frames in which rays start at their entry where something was missed
MOST_RESTARTED = 1 / 2  # share of pixels that start at their entry, above which all do
SQUARE = BLOCK * BLOCKS  # pixels along the side of a square, in which the rays of one block are checked
Bricks = tuple[BrickBox, bytes]


@dataclass(frozen=True)
class Found:
    """Hits of the rays of one piece.

    Attributes
    ----------
    plan, rect : plan and pixels of the frame
    hits : float32 (3, rows, columns), (x, y, z) in index space; NaN where a ray met nothing
    drawn : bool (rows, columns), pixels of the blocks chosen at random to be checked
    suspects : float64 (n, 4), (x, y, z) of missed hits, and the frame in which each was last found
    """

    plan: Plan
    rect: Rect
    hits: NDArray[np.float32]
    drawn: NDArray[np.bool_]
    suspects: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))


class LastFrame:
    """Hits of the last frame of a ray caster, piece by piece."""

    def __init__(self) -> None:
        self._last: dict[Bricks, Found] = {}
        self._now: dict[Bricks, Found] = {}
        self._frame = 0

    def forget(self) -> None:
        """Discard all hits, as the bricks have changed."""
        self._last, self._now = {}, {}

    def next_frame(self) -> None:
        """Begin a frame; the current one becomes the last one."""
        self._last, self._now = self._now, {}
        self._frame += 1

    def arrays(self, plan: Plan, bricks: Bricks, rect: Rect, shape: tuple[int, int]) -> dict[str, NDArray[np.float32]]:
        """Return the view depths at which a piece's rays start, and the array that receives their hits.

        Parameters
        ----------
        bricks : the box around the bricks to draw, and their indices
        shape : rows and columns in memory

        Returns
        -------
        arrays : `starts`, float32 (rows, columns): 0 if the ray starts at its entry, infinite if it meets nothing,
            negative if it is checked; and `hits`, as in `Found`, to be written
        """
        starts, last = np.zeros(shape, np.float32), self._last.get(bricks)
        hits, drawn, suspects = np.empty((3, *shape), np.float32), np.zeros(shape, np.bool_), np.empty((0, 4))
        if last is not None and _still_holds(last.plan, plan):
            box = _box_of(plan, bricks[0])
            if is_coherent(last.plan.view, plan.view, box):
                suspects, restarted = self._suspected(last, plan, rect, shape)
                if restarted.mean() <= MOST_RESTARTED:
                    starts = np.full(shape, np.inf, np.float32)
                    smooth_depth = SMOOTH * plan.march.step_world
                    reproject((last.plan.view, plan.view), (last.rect, rect), box, smooth_depth, last.hits, starts)
                    drawn = (
                        self._drawn_at_random([*bricks[0].begin_zyx, rect.x_begin, rect.y_begin], shape) & ~restarted
                    )
                    np.negative(starts, where=drawn | restarted, out=starts)
        self._now[bricks] = Found(plan, rect, hits, drawn, suspects)
        return {"starts": starts, "hits": hits}

    def finish(
        self, bricks: Bricks, missed: NDArray[np.float32], estimated: int, left_out: int, late: int
    ) -> FrameCoherence:
        """Store the hits that checked rays would have missed, and return the counts of all rays.

        Parameters
        ----------
        bricks : those of a piece whose `arrays` are written
        missed : float32 (rows, columns), opacity that checked rays gathered before their starts; -1 for other rays
        estimated, left_out, late : numbers of rays, as in `FrameCoherence`
        """
        found = self._now[bricks]
        rows, columns = np.nonzero(missed > VISIBLE)
        _, one_a_square = np.unique(rows // SQUARE * missed.shape[1] + columns // SQUARE, return_index=True)
        places = found.hits[:, rows[one_a_square], columns[one_a_square]].T
        new = np.column_stack([places, np.full(len(places), self._frame)])
        self._now[bricks] = replace(found, suspects=np.concatenate([found.suspects, new]))
        errors = missed[found.drawn[: missed.shape[0], : missed.shape[1]] & (missed >= 0.0)]
        wrong, error = int(np.count_nonzero(errors > VISIBLE)), float(errors.max(initial=0.0))
        return FrameCoherence(estimated, left_out, late, errors.size, wrong, error)

    def _suspected(
        self, last: Found, plan: Plan, rect: Rect, shape: tuple[int, int]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return recently missed hits, one per square, and the pixels (rows, columns) of the squares around them."""
        recent = last.suspects[last.suspects[:, 3] > self._frame - SUSPECTED][::-1]
        squares = np.zeros([-(-side // SQUARE) + 2 for side in shape], np.bool_)
        column, row = ((project(plan.view, recent[:, :3])[:, :2] + 0.5 - (rect.x_begin, rect.y_begin)) // SQUARE).T
        inside = (row >= 0) & (row < squares.shape[0] - 2) & (column >= 0) & (column < squares.shape[1] - 2)
        rows, columns, recent = row[inside].astype(int), column[inside].astype(int), recent[inside]
        for down in range(3):
            for right in range(3):
                squares[rows + down, columns + right] = True
        _, latest = np.unique(rows * squares.shape[1] + columns, return_index=True)
        return recent[latest[::-1]], _pixels(squares[1:-1, 1:-1], SQUARE, shape)

    def _drawn_at_random(self, piece: list[int], shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Return the pixels of one block of each square, chosen independently of earlier frames."""
        chosen = np.random.default_rng([self._frame, *piece]).integers(BLOCKS**2, size=[-(-n // SQUARE) for n in shape])
        blocks = chosen[:, None, :, None] == np.arange(BLOCKS**2).reshape(BLOCKS, 1, BLOCKS)
        return _pixels(blocks.reshape(chosen.shape[0] * BLOCKS, -1), BLOCK, shape)


def _pixels(squares: NDArray[np.bool_], side: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return flags of pixels (rows, columns) from flags of squares."""
    return squares.repeat(side, axis=0).repeat(side, axis=1)[: shape[0], : shape[1]]


def depth_of(plan: Plan) -> NDArray[np.float64]:
    """Return the row (4,) of the projection that gives view depths."""
    row: NDArray[np.float64] = projection_of(plan.view)[2]
    return row


def _still_holds(last: Plan, plan: Plan) -> bool:
    """Return True if only the camera differs; then the frames share all other values."""
    names = ("march", "blend_mode", "clip", "encoding", "transfer", "segments", "layout", "cost", "multi_volume")
    return all(getattr(last, name) is getattr(plan, name) for name in names)


def _box_of(plan: Plan, box: BrickBox) -> Box:
    begin, end = plan.layout.cells_of(box.begin_zyx, box.end_zyx)
    return Box(begin[::-1], end[::-1])
