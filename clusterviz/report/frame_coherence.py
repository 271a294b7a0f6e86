"""What `quality.frame_coherence` was good for in a frame, and what it may have missed.

Of each square of 16 blocks of 16 rays those of one block, drawn at random, start where they enter the volume. What such
a ray gathers before it comes to where it would have started is what the picture would have missed: an error of at most
its opacity, in every channel. Of all rays, how many err is then bounded with a confidence; how much they err is not.

References
----------
W. Hoeffding: Probability inequalities for sums of bounded random variables, Journal of the American Statistical
Association 58, 1963 (theorem 1, as Chernoff's bound on a sum of independent numbers between 0 and 1).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

VISIBLE = 1 / 255
BLOCK, BLOCKS = 4, 4
"""Pixels along the side of a block, and blocks along the side of a square, of which one is drawn."""
DOUBT = 0.05
COUNTS = ("estimated", "left_out", "late", "checked", "wrong")


@dataclass(frozen=True)
class FrameCoherence:
    """One frame's rays.

    Attributes
    ----------
    estimated : the last frame told where to start
    left_out : it told that they meet nothing, so they were not drawn; those beside the volume's box are among them
    late : of `estimated`, those that noticed that they had started too late, and began again
    checked : drawn at random, started where they enter the volume, and found what they would have missed
    wrong : of these, those that would have missed more than 1/255 of a full scale
    error : the most that one of them would have missed, of a full scale of 1
    wrong_at_most : of all rays no more missed more than 1/255, with a confidence of 95 %
    beyond_at_most : nor did more than these miss more than `error`
    """

    estimated: int = 0
    left_out: int = 0
    late: int = 0
    checked: int = 0
    wrong: int = 0
    error: float = 0.0
    wrong_at_most: int = field(init=False)
    beyond_at_most: int = field(init=False)

    def __post_init__(self) -> None:
        """Bound what was not checked by what was."""
        for name, found in (("wrong_at_most", self.wrong), ("beyond_at_most", 0)):
            object.__setattr__(self, name, min(rays_at_most(found), self.estimated + self.left_out + self.checked))

    def __str__(self) -> str:
        """What was saved, and missed, in a line."""
        rays = f"{self.estimated:,} rays started later, {self.left_out:,} were left out"
        checked = (
            f"of {self.checked:,} checked {self.wrong:,} would have missed more than 1/255, {self.error:.2g} at most"
        )
        return f"{rays}; {checked}; of all at most {self.wrong_at_most:,} did (95 % confidence)"


def together(each: Iterable[FrameCoherence | None]) -> FrameCoherence | None:
    """All of several pieces, ranks or frames; None where nothing leapt."""
    some = [one for one in each if one is not None]
    if not some:
        return None
    estimated, left_out, late, checked, wrong = (sum(getattr(one, name) for one in some) for name in COUNTS)
    return FrameCoherence(estimated, left_out, late, checked, wrong, max(one.error for one in some))


def rays_at_most(found: int) -> int:
    """The number of rays of a kind that are not exceeded, but in one case of twenty, where so many were drawn.

    Blocks count as a whole, so rays may be of that kind side by side.
    """
    # Drawn blocks hold `low` of them by their size; less than that has a probability of exp(low - high + ...) at most.
    low = found / BLOCK**2
    high, step = low, 1.0
    while step > 1e-9:
        more = high + step
        if more - low - low * math.log(more / low if low else 1.0) <= -math.log(DOUBT):
            high = more
        else:
            step /= 2
    return math.ceil(high * BLOCK**2 * BLOCKS**2)
