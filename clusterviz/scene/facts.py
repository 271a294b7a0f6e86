"""What is known of a volume's values and place before it is decided how it is shown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class VolumeFacts:
    """What must be known of a volume to choose how it is shown.

    Attributes
    ----------
    shape_zyx : samples along z, y, x
    spacing : world units between samples along x, y, z
    corners : float64 (8, 3), the corners of its box in the world
    minimum, maximum, percentile_1, percentile_99 : data values; without meaning where the volume has no finite sample
    finite : samples that are neither NaN nor infinite
    orientation : see `Grid.orientation`
    is_integer : the type of the samples is one of whole numbers
    histogram : int64 (bins,), of equal bins from minimum to maximum
    blocks : float64 (2, z, y, x blocks): the extremes of blocks of as many cells, but for the last along each axis
    block_sides : of them, in cells along z, y and x
    values, counts : float64 (n,), int64 (n,); values that may be categories, and how many samples have each; None where
        samples are no whole numbers, or of very many values
    equal_share : of neighbours that are not both of the commonest value, those that are equal
    jump_share : of neighbours that are not equal, those that differ by more than 1
    """

    shape_zyx: tuple[int, int, int]
    spacing: tuple[float, float, float]
    corners: NDArray[np.float64]
    minimum: float
    maximum: float
    percentile_1: float
    percentile_99: float
    finite: int = 1
    orientation: str = ""
    is_integer: bool = False
    histogram: NDArray[np.int64] | None = None
    blocks: NDArray[np.float64] | None = None
    block_sides: tuple[int, int, int] = (1, 1, 1)
    values: NDArray[np.float64] | None = None
    counts: NDArray[np.int64] | None = None
    equal_share: float = 0.0
    jump_share: float = 0.0
