"""Frame coherence in OpenGL: starts of rays, and their outcome, as planes of floats for starts.glsl."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.gl.layout import glsl_block
from clusterviz.image.region import Rect
from clusterviz.partition import Piece, bounding_box
from clusterviz.plan.plan import Plan
from clusterviz.render.coherence.last_frame import Bricks, LastFrame, depth_of
from clusterviz.report.frame_coherence import FrameCoherence

STARTS = np.dtype(
    [
        ("depth", "f8", 4),  # row (a, b, c, d): the view depth of (x, y, z) is ax + by + cz + d
        ("offset", "i4"),  # slabs between the start of a ray and the predicted hit
        ("again", "i4"),  # 1: only rays that have started too late are drawn, from their entry
    ]
)
BINDING = 8
STARTS_BLOCK = glsl_block("starts", BINDING, STARTS)
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
    block["depth"], block["offset"], block["again"] = depth_of(plan), plan.march.frame_coherence, again
    return block
