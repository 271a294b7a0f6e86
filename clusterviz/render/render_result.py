"""What a ray caster gives, and the pixels that it draws: the same for every one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import PartialImage
from clusterviz.image.region import Rect
from clusterviz.partition import Piece
from clusterviz.plan.plan import Plan
from clusterviz.report.frame_coherence import FrameCoherence

SQUARE = 8  # pixels along the side of what samples are counted by
Tell = Callable[[float], None]
"""Told what part of the drawing is done, in [0, 1]."""
TELL_SECONDS = 0.25
"""How often it is told, where the device can be asked so often."""


def untold(done: float) -> None:
    """Where nobody wants to know."""


@dataclass(frozen=True)
class PartOf:
    """Tells of one of several equal parts as part of the whole; of nothing, where it is not known how many they are."""

    tell: Tell
    number: int
    count: int

    def __call__(self, done: float) -> None:
        """So much of this part is done."""
        if self.count:
            self.tell(min(1.0, (self.number + done) / self.count))


@dataclass(frozen=True)
class RenderResult:
    """What drawing one piece gave.

    Attributes
    ----------
    partial : float32; `image/merge.py` says what four floats are, by the operator of the plan's look
    samples : field samples taken
    bricks : bricks drawn
    seconds_render, seconds_readback : until the pixels were done, and until they were here
    occluded : bricks not drawn, since all rays ended in front of them
    leaping : what the last frame was good for; None where nothing of it was asked
    work : uint32 (rows, columns), the samples of each square of `SQUARE` pixels of the partial image, from its corner
    """

    partial: PartialImage
    samples: int = 0
    bricks: int = 0
    seconds_render: float = 0.0
    seconds_readback: float = 0.0
    work: NDArray[np.uint32] = field(default_factory=lambda: np.zeros((0, 0), np.uint32))
    occluded: int = 0
    frame_coherence: FrameCoherence | None = None


def footprint(plan: Plan, piece: Piece) -> Rect:
    """The pixels of its window that a piece may cover."""
    begin, end = plan.layout.cells_of(piece.box.begin_zyx, piece.box.end_zyx)
    rect = plan.view.footprint(begin[::-1], end[::-1])
    return rect if piece.rect is None else rect.intersect(piece.rect)
