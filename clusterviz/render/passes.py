"""Passes over the bricks of a piece that are not all in memory: its parts are loaded and drawn one after another.

The parts of a piece are disjoint boxes of bricks, sorted from front to back. Rays go on from part to part with their
sums, so the picture is that of a single pass, bit for bit. A part that no ray reaches is not loaded.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.plan.view import View

RAYS = 4096
"""Rays that are tested at a time."""
SLACK = 1e-3
"""Voxels by which boxes are enlarged, so that rounding leaves out no ray."""


class Passes(Protocol):
    """Loading of bricks beside drawing.

    Attributes
    ----------
    seconds : spent in `load`
    """

    seconds: float

    def parts(self, piece: Piece) -> list[Piece]:
        """Return the parts of a piece from front to back; the bricks of each fit into memory."""
        ...

    def load(self, part: Piece, layer: Piece | None = None, following: Piece | None = None) -> None:
        """Load the bricks of a part, or those of them that a layer of it shows.

        Parameters
        ----------
        following : part that rays reach next, as far as is known; None: by the order of the parts
        """
        ...


def is_reached(plan: Plan, part: Piece, window: Rect, opacity: NDArray[np.float32]) -> bool:
    """Return True if a ray that goes on behind its pixel meets the box of a part.

    An opaque pixel hides everything even if rays do not end early: what is behind is multiplied by zero.

    Parameters
    ----------
    window : pixels that the part may cover
    opacity : float32 (h, w), theirs so far
    """
    if not plan.blend_mode.traits.composited:
        return True
    rows, columns = np.nonzero(np.float32(1.0) - opacity > np.float32(max(0.0, plan.march.residual)))
    corners = plan.layout.cells_of(part.box.begin_zyx, part.box.end_zyx)
    begin, end = (np.array(corner[::-1], float) for corner in corners)
    # Mostly some of the first rays meet the box.
    for first in range(0, len(rows), RAYS):
        some = slice(first, first + RAYS)
        origin, direction = _rays(plan.view, window.x_begin + columns[some], window.y_begin + rows[some])
        with np.errstate(divide="ignore", invalid="ignore"):
            to_faces = (np.stack([begin - SLACK, end + SLACK])[:, None] - origin) / direction
        # 0 / 0: the ray lies in a face.
        enters, leaves = np.fmin.reduce(to_faces, axis=0), np.fmax.reduce(to_faces, axis=0)
        if (np.maximum(np.nanmax(enters, axis=1), 0.0) <= np.nanmin(leaves, axis=1)).any():
            return True
    return False


def _rays(view: View, x: NDArray[np.int64], y: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return origins and directions (n, 3) of the rays of pixels in index space, as in march/ray.glsl."""
    across, above = (x + 0.5 - view.centre[0]) * view.pixel, (view.centre[1] - y - 0.5) * view.pixel
    aside = np.outer(across, view.right) + np.outer(above, view.up)
    eye, forward = np.broadcast_to(view.eye, aside.shape), np.broadcast_to(view.forward, aside.shape)
    return (eye + aside, forward) if view.parallel else (eye, forward + aside)
