"""Rays saved by `quality.frame_coherence` in a frame, and its estimated error.

In each square of 16 blocks of 16 rays, those of one block, chosen at random, start where they enter the volume. The
opacity that such a ray gathers before its predicted start bounds the error in every channel. The number of wrong rays
is then bounded with a confidence; the size of their error is not.

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
"""Pixels along the side of a block, and blocks along the side of a square, one of which is checked."""
DOUBT = 0.05
COUNTS = ("estimated", "left_out", "late", "checked", "wrong")


@dataclass(frozen=True)
class FrameCoherence:
    """Counts of one frame's rays.

    Attributes
    ----------
    estimated : rays that started by the last frame's hits
    left_out : rays predicted to meet nothing, which were not drawn, including those beside the volume's box
    late : rays of `estimated` that found that they had started too late, and were drawn again
    checked : rays, chosen at random, that started where they enter the volume and measured their error
    wrong : rays of `checked` with an error above 1/255 of a full scale
    error : largest error of a checked ray, with a full scale of 1
    wrong_at_most : bound on the rays with an error above 1/255, with a confidence of 95 %
    beyond_at_most : bound on the rays with an error above `error`, likewise
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
        """Set the bounds."""
        for name, found in (("wrong_at_most", self.wrong), ("beyond_at_most", 0)):
            object.__setattr__(self, name, min(rays_at_most(found), self.estimated + self.left_out + self.checked))

    def __str__(self) -> str:
        """Return a summary in one line."""
        rays = f"{self.estimated:,} rays started later, {self.left_out:,} were left out"
        checked = (
            f"of {self.checked:,} checked {self.wrong:,} would have missed more than 1/255, {self.error:.2g} at most"
        )
        return f"{rays}; {checked}; of all at most {self.wrong_at_most:,} did (95 % confidence)"


def together(each: Iterable[FrameCoherence | None]) -> FrameCoherence | None:
    """Sum the counts of several pieces, ranks or frames; None if frame coherence was off."""
    some = [one for one in each if one is not None]
    if not some:
        return None
    estimated, left_out, late, checked, wrong = (sum(getattr(one, name) for one in some) for name in COUNTS)
    return FrameCoherence(estimated, left_out, late, checked, wrong, max(one.error for one in some))


def rays_at_most(found: int) -> int:
    """Return an upper bound on the rays of a kind, with a confidence of 95 %, if `found` were among those checked.

    Blocks are counted as a whole, so that neighbouring rays may depend on each other.
    """
    # By Chernoff's bound, if `high` are expected, `low` or less have a probability of exp(low - high + ...) at most.
    low = found / BLOCK**2
    high, step = low, 1.0
    while step > 1e-9:
        more = high + step
        if more - low - low * math.log(more / low if low else 1.0) <= -math.log(DOUBT):
            high = more
        else:
            step /= 2
    return math.ceil(high * BLOCK**2 * BLOCKS**2)
