"""Where rays that OpenGL draws start by the last frame, and what they tell of it: planes of floats for starts.glsl."""

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
        ("depth", "f8", 4),  # the view depth of (x, y, z) is their product with the first three, and the last
        ("offset", "i4"),  # slabs before that with which rays start
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
    """The pixels of a piece, or some rows of them.

    Attributes
    ----------
    last_frame, bricks : of the caster, and of the piece
    starts, hits : float32 (rows, columns) and (3, rows, columns), as of `LastFrame.arrays`; the latter are written
    told : float32 (rows, columns), what became of each ray, written
    """

    last_frame: LastFrame
    bricks: Bricks
    starts: NDArray[np.float32]
    hits: NDArray[np.float32]
    told: NDArray[np.float32]

    @classmethod
    def of(cls, last_frame: LastFrame, plan: Plan, piece: Piece, rect: Rect) -> Starts:
        """What the last frame tells of the pixels of a piece, which has bricks that are shown."""
        members = piece.members(plan.cost > 0)
        bricks, size = (bounding_box(members), members.tobytes()), (rect.height, rect.width)
        return cls(last_frame, bricks, **last_frame.arrays(plan, bricks, rect, size), told=np.empty(size, np.float32))

    def rows(self, begin: int, end: int) -> Starts:
        """Some rows of pixels; what is written of them is written here, too."""
        hits, told = self.hits[:, begin:end], self.told[begin:end]
        return replace(self, starts=self.starts[begin:end], hits=hits, told=told)

    @property
    def planes(self) -> NDArray[np.float32]:
        """What the shader begins with, float32 (5, rows, columns): starts, what is told, and hits."""
        return np.stack([self.starts, np.full_like(self.starts, AT_ENTRY), *np.full_like(self.hits, np.nan)])

    def keep(self, planes: NDArray[np.float32]) -> bool:
        """Keep what the shader has left of the planes; whether some rays have to be drawn again."""
        self.told[:], self.hits[:] = planes[1], planes[2:]
        return bool(np.any(self.told == LATE))

    def finish(self, opacity: NDArray[Any]) -> FrameCoherence:
        """Say what became of all rays of a piece.

        Parameters
        ----------
        opacity : float32 (rows, columns), of its picture
        """
        never_came_to_start, late = self.told == NOT_YET, int(np.count_nonzero(self.told == LATE))
        missed = np.where(never_came_to_start, opacity, np.where(self.told >= 0.0, self.told, UNCHECKED))
        estimated = int(np.count_nonzero(self.told == ESTIMATED)) + late
        left_out = int(np.count_nonzero(self.starts >= NOTHING))
        return self.last_frame.finish(self.bricks, missed, estimated, left_out, late)


def starts_block(plan: Plan, again: bool) -> NDArray[np.void]:
    """The record of the shader's block `starts`; `STARTS` (1,)."""
    block = np.zeros(1, STARTS)
    block["depth"], block["offset"], block["again"] = depth_of(plan), plan.march.frame_coherence, again
    return block
