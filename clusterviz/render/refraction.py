"""Drawing of rays that bend: paths are kept between draws, until none waits for bricks.

A path may leave the bricks that are loaded, in any direction and more than once. It then waits for others. If all
bricks of a piece are loaded, one draw suffices. Else its parts, boxes of bricks that fit into memory, are loaded in
turn: the one next for which most paths wait.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.layout import glsl_block
from clusterviz.image.partial import Rect, blank
from clusterviz.partition import BrickBox, Piece
from clusterviz.plan.plan import Plan
from clusterviz.plan.refraction import MOST_REFLECTIONS
from clusterviz.render.crossing import Crossing
from clusterviz.render.frame_coherence import starts_block
from clusterviz.render.passes import Passes
from clusterviz.render.render_result import RenderResult, footprint

REFRACTION = np.dtype(
    [
        ("metric_x", "f8", 4),
        ("metric_y", "f8", 4),
        ("metric_z", "f8", 4),
        ("inverse_x", "f8", 4),
        ("inverse_y", "f8", 4),
        ("inverse_z", "f8", 4),
        ("limits", "f8", 4),  # index outside, whether the index has steps, most slabs and most reflections of a path
        ("shown_begin", "i4", 4),
        ("shown_end", "i4", 4),
    ]
)
REFRACTION_BLOCK = glsl_block("refraction", 39, REFRACTION)
PLANES = 19
STATUS, AWAITED, POSITION, MOMENTUM = 0, 4, 7, 13
CUT_SHORT = 3
"""As in paths.glsl."""


def refraction_block(plan: Plan) -> NDArray[np.void]:
    """Return the record of the shader's block `refraction`; `REFRACTION` (1,)."""
    given, block = plan.refraction, np.zeros(1, REFRACTION)
    assert given, "rays bend"
    inverse = np.linalg.inv(given.metric)
    for number, axis in enumerate("xyz"):
        block[f"metric_{axis}"][0, :3], block[f"inverse_{axis}"][0, :3] = given.metric[number], inverse[number]
    has_steps = float(plan.volume.segments.records["region"].max() > 0)
    block["limits"] = given.outside, has_steps, given.most_slabs, MOST_REFLECTIONS
    block["shown_begin"][0, :3], block["shown_end"][0, :3] = given.begin, given.end
    return block


def rays_block(plan: Plan, again: bool) -> tuple[str, NDArray[np.void]]:
    """Return the block of rays with planes, `refraction` or `starts`: its name, and its record."""
    return ("refraction", refraction_block(plan)) if plan.refraction else ("starts", starts_block(plan, again))


@dataclass(frozen=True)
class Paths:
    """Paths of the rays of a piece at one wavelength, or of some rows of its pixels.

    Attributes
    ----------
    planes : float32 (19, rows, columns), as paths.glsl keeps them
    pixels : float32 (2, rows, columns, 4), fluxes so far, and their rounding errors
    """

    planes: NDArray[np.float32]
    pixels: NDArray[np.float32]

    @classmethod
    def beginning(cls, rect: Rect) -> Paths:
        """Return paths that have not begun."""
        planes = np.zeros((PLANES, rect.height, rect.width), np.float32)
        planes[AWAITED] = -1
        return cls(planes, np.zeros((2, rect.height, rect.width, 4), np.float32))

    def rows(self, begin: int, end: int) -> Paths:
        """Return a view of some rows of pixels."""
        return Paths(self.planes[:, begin:end], self.pixels[:, begin:end])

    def keep(self, planes: NDArray[np.float32]) -> bool:
        """Store the planes that the shader has written; False, as no ray has to be drawn again."""
        self.planes[:] = planes
        return False

    @property
    def cut_short(self) -> int:
        """Number of paths that were ended."""
        return int(np.count_nonzero(self.planes[STATUS] == CUT_SHORT))

    def awaited(self) -> NDArray[np.int64]:
        """Return the cells (x, y, z) for whose bricks paths wait, int64 (n, 3)."""
        cells = self.planes[AWAITED : AWAITED + 3, self.planes[AWAITED] >= 0]
        return cells.T.astype(np.int64)


CarriedRays = Crossing | Paths
"""Rays that begin with given pixels and planes."""
DrawPaths = Callable[[Plan, Piece, Paths], RenderResult]


def draw_paths(
    draw: DrawPaths, plans: Sequence[Plan], pieces: Sequence[Piece], passes: Passes | None
) -> list[list[RenderResult]]:
    """Draw pieces of the same bricks at several wavelengths, whose rays bend.

    Parameters
    ----------
    draw : goes on with the paths of a piece at the wavelength of a plan
    plans : of each wavelength
    pieces : of this rank, which differ in their pixels
    passes : loads the bricks of parts; None: all are loaded

    Returns
    -------
    drawn : for each piece the result at each wavelength
    """
    rects = [footprint(plans[0], piece) for piece in pieces]
    paths = [[Paths.beginning(rect) for _ in plans] for rect in rects]
    drawn = [[RenderResult(blank()) for _ in plans] for _ in pieces]
    parts: Sequence[Piece] = (passes.parts(pieces[0]) if passes else [pieces[0]]) if pieces else []
    goes_on, part = bool(parts), 0
    while goes_on:
        if passes:
            passes.load(parts[part])
        for number, piece in enumerate(pieces):
            own = replace(parts[part], rect=rects[number]) if len(parts) > 1 else piece
            for n, plan in enumerate(plans):
                found = draw(plan, own, paths[number][n])
                drawn[number][n] = _added(drawn[number][n], found)
        waiting = _waiting(plans[0], parts, [one for each in paths for one in each])
        part, goes_on = int(waiting.argmax()), bool(waiting.any())
    return [
        [replace(one, cut_short=each.cut_short) for one, each in zip(row, own, strict=True)]
        for row, own in zip(drawn, paths, strict=True)
    ]


def _added(before: RenderResult, found: RenderResult) -> RenderResult:
    """Return the result of two draws of the same pixels, the second of which has gone on with the first one's paths."""
    if not found.partial.rect.pixels:
        return before
    return replace(
        found,
        samples=before.samples + found.samples,
        bricks=before.bricks + found.bricks,
        seconds_render=before.seconds_render + found.seconds_render,
        seconds_readback=before.seconds_readback + found.seconds_readback,
        work=found.work + before.work if before.work.shape == found.work.shape else found.work,
    )


def _waiting(plan: Plan, parts: Sequence[Piece], paths: Sequence[Paths]) -> NDArray[np.int64]:
    """Return how many paths wait for the bricks of each part."""
    cells = np.concatenate([one.awaited() for one in paths])
    bricks = np.stack(
        [
            np.searchsorted(borders, at, side="right") - 1
            for borders, at in zip(plan.layout.borders_zyx, cells.T[::-1], strict=True)
        ],
        axis=1,
    )
    boxes = [part.box for part in parts]
    found = [np.count_nonzero(((bricks >= box.begin_zyx) & (bricks < box.end_zyx)).all(axis=1)) for box in boxes]
    return np.array(found, np.int64)


def boxes_that_fit(sizes: NDArray[np.int64], box: BrickBox, most: int) -> list[BrickBox]:
    """Cut a box of bricks until each part fits into memory; every brick of the box is in one part.

    Parameters
    ----------
    sizes : int64 (bz, by, bx), bytes of all bricks; 0 for those that are not loaded
    most : bytes of a part; a single brick may have more

    Returns
    -------
    boxes : each with a brick that is loaded
    """
    inside = np.argwhere(sizes[box.slices])
    if len(inside) < 2 or int(sizes[box.slices].sum()) <= most:
        return [box]
    axis = int(np.argmax(np.ptp(inside, axis=0)))
    # Between the bricks in the middle, with some on either side.
    middle = max(int(np.median(inside[:, axis])), int(inside[:, axis].min()) + 1) + box.begin_zyx[axis]
    end, begin = list(box.end_zyx), list(box.begin_zyx)
    end[axis] = begin[axis] = middle
    low, high = BrickBox(box.begin_zyx, (end[0], end[1], end[2])), BrickBox((begin[0], begin[1], begin[2]), box.end_zyx)
    return [*boxes_that_fit(sizes, low, most), *boxes_that_fit(sizes, high, most)]
