"""Information on a volume that scene completion uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class VolumeInfo:
    """Grid and value statistics of a volume.

    Attributes
    ----------
    shape_zyx : samples along z, y, x
    spacing : distance of samples along x, y, z, world units
    corners : float64 (8, 3), corners of the volume's box, world
    minimum, maximum, percentile_1, percentile_99 : data values; undefined if the volume has no finite sample
    finite : number of samples that are neither NaN nor infinite
    orientation : see `Grid.orientation`
    is_integer : whether the samples have an integer type
    histogram : int64 (bins,), equal bins from minimum to maximum
    blocks : float64 (2, z, y, x), minimum and maximum of each block; the last along an axis may be smaller
    block_sides : sides of a block along z, y and x, cells
    values, counts : float64 (n,), int64 (n,), distinct values and their numbers of samples; None if the samples are not
        whole numbers, or have too many distinct values
    equal_share : share of equal pairs among neighbouring samples that do not both have the most frequent value
    jump_share : share of pairs that differ by more than 1 among unequal neighbouring samples
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
