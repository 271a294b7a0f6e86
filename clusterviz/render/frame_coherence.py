"""Frame coherence: rays start shortly before the hits of the ray caster's last frame.

The hits are discarded if the transfer function, blend mode, step or clipping planes change, if bricks come or go, or if
the camera jumps. Then rays start where they enter the volume. So do the rays of blocks chosen at random, as rays that
start behind a thin feature which the last frame missed would never find it. If one of them has found something, all
rays around it start at their entry for some frames. `reprojection_kernel.py` reprojects the hits; `Starts` holds starts
of rays, and their outcome, as planes of floats for starts.glsl.

References
----------
M. Strengert, Parallel Visualization and Compute Environments for Graphics Clusters, Stuttgart 2010, section 3.3.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.layout import glsl_block
from clusterviz.image.partial import Rect
from clusterviz.kernels.compiled import CompiledKernel
from clusterviz.partition import BrickBox, Piece, bounding_box
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import View
from clusterviz.report.counts import BLOCK, BLOCKS, VISIBLE, FrameCoherence

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
        if last is not None and still_holds(last.plan, plan):
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


def still_holds(last: Plan, plan: Plan) -> bool:
    """Return True if only the camera differs; then the frames share all other values."""
    names = ("march", "clip", "content", "cost")
    return all(getattr(last, name) is getattr(plan, name) for name in names)


def _box_of(plan: Plan, box: BrickBox) -> Box:
    begin, end = plan.layout.cells_of(box.begin_zyx, box.end_zyx)
    return Box(begin[::-1], end[::-1])


_REPROJECT = CompiledKernel(
    "clusterviz.render.reprojection_kernel",
    "reproject",
    "float64[::1]; int64[::1]; float32[:,:,::1]; float32[:,:,::1]; float32[:,::1]",
    [Path(__file__).with_name("reprojection_kernel.py")],
)
JUMP = 1 / 8
"""Share of the picture's longer side that a corner of the box may move from frame to frame."""
Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """A box of cells in index space, (x, y, z)."""

    begin: Corner
    end: Corner

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corners, float64 (8, 3)."""
        ends = np.array([self.begin, self.end])
        return np.array([ends[[b & 1, b >> 1 & 1, b >> 2], range(3)] for b in range(8)])


def is_coherent(last: View, view: View, box: Box) -> bool:
    """Return True if the hits of one view of a box predict the starts of the next.

    Pictures have one size, no part of the box is beside or behind an eye, no side of it comes into view, and no corner
    jumps.
    """
    if last.size != view.size or last.parallel != view.parallel or np.any(_sides(view, box) & ~_sides(last, box)):
        return False
    places = [project(each, box.corners) for each in (last, view)]
    size = float(np.abs(box.corners).max() + 1) * 1e-9
    if any(
        place[:, 2].min() <= size * np.linalg.norm(each.forward)
        for place, each in zip(places, (last, view), strict=True)
    ):
        return False
    return bool(np.abs(places[0] - places[1])[:, :2].max() <= JUMP * max(view.size))


def project(view: View, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return pixels (x, y), with integers at their centres, and view depths of points (n, 3) in index space; (n, 3)."""
    lens = projection_of(view)
    aside, above, depth = (points @ lens[row, :3] + lens[row, 3] for row in range(3))
    scale = view.pixel * (np.ones_like(depth) if view.parallel else depth)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([lens[3, 0] - 0.5 + aside / scale, lens[3, 1] - 0.5 - above / scale, depth], axis=1)


def projection_of(view: View) -> NDArray[np.float64]:
    """Return the map from index space to pixels (4, 4): rows right, up and ahead of the eye; then the lens."""
    inverse = np.linalg.inv(np.array([view.right, view.up, view.forward]).T)
    return np.vstack([np.column_stack([inverse, -inverse @ np.array(view.eye)]), _lens(view)])


def rays_of(view: View) -> NDArray[np.float64]:
    """Return the map from pixels to index space (4, 4): eye, right, up and forward as columns; then the lens."""
    return np.vstack([np.array([view.eye, view.right, view.up, view.forward]).T, _lens(view)])


def reproject(
    views: tuple[View, View],
    rects: tuple[Rect, Rect],
    box: Box,
    smooth_depth: float,
    hits: NDArray[np.float32],
    starts: NDArray[np.float32],
) -> None:
    """Lower view depths in `starts` to those at which rays may meet something that the last frame hit or hid.

    Parameters
    ----------
    views, rects : views of the last frame and of this one, which are coherent, and the pixels that may show the box
    smooth_depth : largest difference between the depths of neighbouring hits on one surface
    hits : float32 (3, rows, columns), (x, y, z) in index space by pixel of the last rectangle; NaN without a hit
    starts : float32 (rows, columns), view depths by pixel of this rectangle
    """
    (last, view), (before, now) = views, rects
    width, height = last.size
    cut = before.x_begin == 0 or before.y_begin == 0 or before.x_end == width or before.y_end == height
    found = _budget(hits[0, : before.height, : before.width]) if not cut else (0, 0, before.width, before.height)
    if found is None:
        return
    lenses = [matrix(each).ravel() for each in (last, view) for matrix in (rays_of, projection_of)]
    numbers = np.concatenate([*lenses, box.begin, box.end, [smooth_depth]])
    shown = _surely_shown(last, view, box, before)
    bounds = (*hits.shape[1:], *_numbers(now), starts.shape[1], cut, *shown, *found)
    sizes = np.array([*_numbers(before), *bounds], np.int64)
    places = np.empty((4, before.height, before.width), np.float32)
    _REPROJECT(numbers, sizes, hits, places, starts)


def prepare_reprojection() -> None:
    """Compile the kernel, or load it."""
    _REPROJECT.prepare()


def _lens(view: View) -> NDArray[np.float64]:
    return np.array([*view.centre, view.pixel, float(view.parallel)])


def _numbers(rect: Rect) -> tuple[int, int, int, int]:
    return rect.x_begin, rect.y_begin, rect.width, rect.height


def _budget(hits: NDArray[np.float32]) -> tuple[int, int, int, int] | None:
    """Return the rectangle (begin and end, x before y) around all hits that are not NaN; None if there is none."""
    there = hits == hits
    columns, rows = (np.flatnonzero(there.any(axis=axis)) for axis in (0, 1))
    if len(rows) == 0:
        return None
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _surely_shown(last: View, view: View, box: Box, rect: Rect) -> tuple[int, int, int, int]:
    """Return the pixels (begin and end, x before y) whose part of the box lay in the last rectangle, too.

    The projection of a point in the box is a mean of those of the corners, weighted by their depths. From view to view
    corners move, and weights change as much as the ratios of the depths differ.
    """
    before, now = (project(each, box.corners) for each in (last, view))
    ratios = now[:, 2] / before[:, 2] if not view.parallel else np.ones(len(now))
    change, spread = float(ratios.max() / ratios.min()) - 1.0, np.ptp(before[:, :2], axis=0).max()
    most = math.ceil(float(np.abs(now - before)[:, :2].max()) + change * float(spread)) + 1
    return rect.x_begin + most, rect.y_begin + most, rect.x_end - most, rect.y_end - most


def _sides(view: View, box: Box) -> NDArray[np.bool_]:
    """Return the low and high sides of the box that face the viewer, bool (2, 3)."""
    if view.parallel:
        forward = np.array(view.forward)
        return np.array([forward > 0, forward < 0])
    eye = np.array(view.eye)
    return np.array([eye < box.begin, eye > box.end])


STARTS = np.dtype(
    [
        ("depth", "f8", 4),  # row (a, b, c, d): the view depth of (x, y, z) is ax + by + cz + d
        ("offset", "i4"),  # slabs between the start of a ray and the predicted hit
        ("again", "i4"),  # 1: only rays that have started too late are drawn, from their entry
    ]
)
STARTS_BLOCK = glsl_block("starts", 39, STARTS)
NOTHING = 1e30
AT_ENTRY, ESTIMATED, LATE, NOT_YET = -1.0, -2.0, -3.0, -4.0
"""As in starts.glsl."""
UNCHECKED = np.float32(-1.0)


@dataclass(frozen=True)
class Starts:
    """Starts, hits and outcome of the rays of a piece, or of some rows of its pixels.

    Attributes
    ----------
    last_frame, bricks : last frame of the caster, and bricks of the piece
    starts, hits : float32 (rows, columns) and (3, rows, columns), as in `LastFrame.arrays`; hits are written
    outcome : float32 (rows, columns), a constant of this module or the opacity that a checked ray would have missed;
        written
    """

    last_frame: LastFrame
    bricks: Bricks
    starts: NDArray[np.float32]
    hits: NDArray[np.float32]
    outcome: NDArray[np.float32]

    @classmethod
    def of(cls, last_frame: LastFrame, plan: Plan, piece: Piece, rect: Rect) -> Starts:
        """Return the starts of a piece, which has visible bricks, from the last frame."""
        members = piece.members(plan.cost > 0)
        bricks, size = (bounding_box(members), members.tobytes()), (rect.height, rect.width)
        return cls(
            last_frame, bricks, **last_frame.arrays(plan, bricks, rect, size), outcome=np.empty(size, np.float32)
        )

    def rows(self, begin: int, end: int) -> Starts:
        """Return a view of some rows of pixels."""
        hits, outcome = self.hits[:, begin:end], self.outcome[begin:end]
        return replace(self, starts=self.starts[begin:end], hits=hits, outcome=outcome)

    @property
    def planes(self) -> NDArray[np.float32]:
        """Planes with which the shader begins, float32 (5, rows, columns): starts, outcome, and hits."""
        return np.stack([self.starts, np.full_like(self.starts, AT_ENTRY), *np.full_like(self.hits, np.nan)])

    def keep(self, planes: NDArray[np.float32]) -> bool:
        """Store the planes that the shader has written; return True if some rays have to be drawn again."""
        self.outcome[:], self.hits[:] = planes[1], planes[2:]
        return bool(np.any(self.outcome == LATE))

    def finish(self, opacity: NDArray[Any]) -> FrameCoherence:
        """Return the counts of all rays of a piece.

        Parameters
        ----------
        opacity : float32 (rows, columns), opacity of its picture
        """
        never_came_to_start, late = self.outcome == NOT_YET, int(np.count_nonzero(self.outcome == LATE))
        missed = np.where(never_came_to_start, opacity, np.where(self.outcome >= 0.0, self.outcome, UNCHECKED))
        estimated = int(np.count_nonzero(self.outcome == ESTIMATED)) + late
        left_out = int(np.count_nonzero(self.starts >= NOTHING))
        return self.last_frame.finish(self.bricks, missed, estimated, left_out, late)


def starts_block(plan: Plan, again: bool) -> NDArray[np.void]:
    """Return the record of the shader's block `starts`; `STARTS` (1,)."""
    block = np.zeros(1, STARTS)
    block["depth"], block["offset"], block["again"] = depth_of(plan), plan.march.frame_coherence or 0, again
    return block
