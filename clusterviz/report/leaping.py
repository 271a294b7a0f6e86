"""What `quality.leaping` was good for in a frame, and the error that it was measured to have.

In each frame the rays of one tile of sixteen start where they enter the volume. What such a ray gathers before it comes
to where it would have started is what the picture would have missed: an error of at most its opacity, in every channel.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

VISIBLE = 1 / 255
COUNTS = ("estimated", "left_out", "late", "checked", "wrong")


@dataclass(frozen=True)
class Leaping:
    """One frame's rays.

    Attributes
    ----------
    estimated : the last frame told where to start
    left_out : it told that they meet nothing, so they were not drawn; those beside the volume's box are among them
    late : of `estimated`, those that noticed that they had started too late, and began again
    checked : started where they enter the volume, and found what they would have missed
    wrong : of these, those that would have missed more than 1/255 of a full scale
    error : the most that one of them would have missed, of a full scale of 1
    """

    estimated: int = 0
    left_out: int = 0
    late: int = 0
    checked: int = 0
    wrong: int = 0
    error: float = 0.0

    def __str__(self) -> str:
        """What was saved, and missed, in a line."""
        rays = f"{self.estimated:,} rays started later, {self.left_out:,} were left out"
        missed = f"{self.wrong:,} would have missed more than 1/255, {self.error:.2g} at most"
        return f"{rays}; of {self.checked:,} checked {missed}"


def together(each: Iterable[Leaping | None]) -> Leaping | None:
    """All of several pieces, ranks or frames; None where nothing leapt."""
    some = [one for one in each if one is not None]
    if not some:
        return None
    estimated, left_out, late, checked, wrong = (sum(getattr(one, name) for one in some) for name in COUNTS)
    return Leaping(estimated, left_out, late, checked, wrong, max(one.error for one in some))
