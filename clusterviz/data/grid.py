"""Regular grid of a volume: number of samples, and their positions in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Triple = tuple[float, float, float]
IDENTITY: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Grid:
    """Regular grid of point samples; the volume fills the box from its first to its last sample.

    World position of sample (i, j, k) along (x, y, z) is origin + direction · (spacing * (i, j, k)).

    Attributes
    ----------
    shape_zyx : samples along z, y, x; each at least 1
    spacing : world units between samples along x, y, z; each > 0
    origin : world position (x, y, z) of sample (0, 0, 0)
    direction : 3 × 3, row by row; column a is the unit vector of index axis a (x, y, z) in the world
    orientation : directions of the world's x, y and z by the first letters of right, left, anterior, posterior,
        superior and inferior, as in "RAS"; "" if unknown
    """

    shape_zyx: tuple[int, int, int]
    spacing: Triple = (1.0, 1.0, 1.0)
    origin: Triple = (0.0, 0.0, 0.0)
    direction: tuple[Triple, Triple, Triple] = IDENTITY
    orientation: str = ""

    @property
    def world_from_index(self) -> NDArray[np.float64]:
        """float64 (4, 4) matrix from (i, j, k, 1) along (x, y, z) to the world."""
        matrix = np.eye(4)
        matrix[:3, :3] = np.asarray(self.direction) * np.asarray(self.spacing)
        matrix[:3, 3] = self.origin
        return matrix

    @property
    def corners(self) -> NDArray[np.float64]:
        """float64 (8, 3), the corners of the volume's box in the world."""
        last = np.array(self.shape_zyx[::-1], float) - 1
        index = np.array([[i, j, k, 1] for k in (0, 1) for j in (0, 1) for i in (0, 1)], float)
        index[:, :3] *= last
        return (index @ self.world_from_index.T)[:, :3]
