"""Counts of what settings save in a frame, and of what they may cost, for statistics.

With `quality.frame_coherence`, in each square of 16 blocks of 16 rays those of one block, chosen at random, start where
they enter the volume. The opacity that such a ray gathers before its predicted start bounds the error in every channel.
The number of wrong rays is then bounded with a confidence; the size of their error is not. Pictures with
`quality.early_discarding` are those without it, bit for bit. A k-buffer counts the pixels that it gets wrong.

References
----------
W. Hoeffding: Probability inequalities for sums of bounded random variables, Journal of the American Statistical
Association 58, 1963 (theorem 1, as Chernoff's bound on a sum of independent numbers between 0 and 1).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

VISIBLE = 1 / 255
BLOCK, BLOCKS = 4, 4
"""Pixels along the side of a block, and blocks along the side of a square, one of which is checked."""
DOUBT = 0.05


@dataclass(frozen=True)
class FrameCoherence:
    """Counts of one frame's rays."""

    estimated: int = 0  # rays that started by the last frame's hits
    left_out: int = 0  # rays predicted to meet nothing, which were not drawn, including those beside the volume's box
    late: int = 0  # rays of `estimated` that found that they had started too late, and were drawn again
    checked: int = 0  # rays, chosen at random, that started where they enter the volume and measured their error
    wrong: int = 0  # rays of `checked` with an error above 1/255 of a full scale
    error: float = 0.0  # largest error of a checked ray, with a full scale of 1
    wrong_at_most: int = field(init=False)  # bound on the rays with an error above 1/255, with a confidence of 95 %
    beyond_at_most: int = field(init=False)  # bound on the rays with an error above `error`, likewise

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


@dataclass(frozen=True)
class EarlyDiscarding:
    """Counts of one frame.

    `stored`: fragments stored, those of pixels that were drawn again twice, and one for each pixel where some were left
    out.
    """

    stored: int = 0
    pixels: int = 0  # pixels where some were left out, without those that were drawn again
    redrawn: int = 0  # pixels drawn again with all fragments, as their rays did not end in front of what was left out

    def __str__(self) -> str:
        """Return a summary in one line."""
        return (
            f"{self.stored:,} fragments stored, some left out at {self.pixels:,} pixels; "
            f"{self.redrawn:,} pixels drawn again, none wrong"
        )


@dataclass(frozen=True)
class KBufferCounts:
    """Counts of one frame; on several ranks sums, so that a pixel counts for each rank that gets it wrong."""

    wrong_pixels: int = 0  # pixels where a fragment arrived that is nearer than the end of a segment composited before
    fragments: int = 0  # intersections of rays and faces
    comparisons: int = 0  # of two fragments' depths

    @classmethod
    def of(cls, counted: NDArray[np.uint32]) -> KBufferCounts:
        """Return the counts of pixels (n, 2) as faces.glsl writes them."""
        fragments, rest = counted.T.astype(np.int64)
        return cls(int((rest & 1).sum()), int(fragments.sum()), int((rest >> 1).sum()))

    def __str__(self) -> str:
        """Return a summary in one line."""
        pixels = f"{self.wrong_pixels:,} pixel" + "s" * (self.wrong_pixels != 1)
        return f"{pixels} with segments out of order" + "; use a larger k, or exact" * (self.wrong_pixels > 0)


Counts = TypeVar("Counts", FrameCoherence, EarlyDiscarding, KBufferCounts)


def all_counts(each: Iterable[Counts | None]) -> Counts | None:
    """Return the counts of several pieces, ranks or frames together, with the largest error; None if there are none."""
    some = [one for one in each if one is not None]
    if not some:
        return None
    names = [one.name for one in fields(some[0]) if one.init]
    found = {name: [getattr(one, name) for one in some] for name in names}
    return type(some[0])(**{name: max(values) if name == "error" else sum(values) for name, values in found.items()})
