"""What a k-buffer has done in a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class KBufferCounts:
    """Counts of one frame; on several ranks sums, so that a pixel counts for each rank that gets it wrong.

    Attributes
    ----------
    wrong_pixels : pixels where a fragment arrived that is nearer than the end of a segment composited before
    fragments : intersections of rays and faces
    comparisons : of two fragments' depths
    """

    wrong_pixels: int = 0
    fragments: int = 0
    comparisons: int = 0

    @classmethod
    def of(cls, counted: NDArray[np.uint32]) -> KBufferCounts:
        """Return the counts of pixels (n, 2) as faces.glsl writes them."""
        fragments, rest = counted.T.astype(np.int64)
        return cls(int((rest & 1).sum()), int(fragments.sum()), int((rest >> 1).sum()))

    def __str__(self) -> str:
        """Return a summary in one line."""
        pixels = f"{self.wrong_pixels:,} pixel" + "s" * (self.wrong_pixels != 1)
        return f"{pixels} with segments out of order" + "; use a larger k, or exact" * (self.wrong_pixels > 0)
