"""Contract of a volume's data: a regular grid in the world, and reading of any box of samples."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Protocol

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
    modality : what the values are, as the file says: CT, MR or another of DICOM's modalities, labels, density (of
        cryo-EM or X-ray crystallography), microscopy; "" if unknown
    """

    shape_zyx: tuple[int, int, int]
    spacing: Triple = (1.0, 1.0, 1.0)
    origin: Triple = (0.0, 0.0, 0.0)
    direction: tuple[Triple, Triple, Triple] = IDENTITY
    orientation: str = ""
    modality: str = ""

    @property
    def world_from_index(self) -> NDArray[np.float64]:
        """float64 (4, 4) matrix from (i, j, k, 1) along (x, y, z) to the world."""
        matrix = np.eye(4)
        matrix[:3, :3] = np.asarray(self.direction) * np.asarray(self.spacing)
        matrix[:3, 3] = self.origin
        return matrix

    def coarser(self, level: int) -> Grid:
        """Return the grid of every 2^level-th sample along each axis."""
        z, y, x = (-(-side // (1 << level)) for side in self.shape_zyx)
        dx, dy, dz = (length * 2.0**level for length in self.spacing)
        return replace(self, shape_zyx=(z, y, x), spacing=(dx, dy, dz))

    def covering(self, level: int) -> Grid:
        """Return that grid with one more sample along each axis where the volume goes on behind its last one."""
        z, y, x = (-(-(side - 1) // (1 << level)) + 1 for side in self.shape_zyx)
        return replace(self.coarser(level), shape_zyx=(z, y, x))

    @property
    def corners(self) -> NDArray[np.float64]:
        """float64 (8, 3), the corners of the volume's box in the world."""
        last = np.array(self.shape_zyx[::-1], float) - 1
        index = np.array([[i, j, k, 1] for k in (0, 1) for j in (0, 1) for i in (0, 1)], float)
        index[:, :3] *= last
        return (index @ self.world_from_index.T)[:, :3]


Index = tuple[int, int, int]


def as_index(numbers: Iterable[int]) -> Index:
    z, y, x = numbers
    return z, y, x


class Source(Protocol):
    """Volume on disk or in memory.

    Attributes
    ----------
    name : for messages: the path as given, with the array's name if there are several
    dtype : of the samples, native byte order: any NumPy integer or float type
    """

    @property
    def name(self) -> str: ...

    @property
    def grid(self) -> Grid: ...

    @property
    def dtype(self) -> np.dtype[Any]: ...

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of the half-open box [begin, end).

        Returns
        -------
        voxels : dtype `self.dtype` (native byte order), shape end − begin, (z, y, x), C order, owned by the caller
        """
        ...


class MultilevelSource(Source, Protocol):
    """Volume with coarser levels; itself it is level 0, the finest.

    Sample i of level n lies on sample 2ⁿ·i along each axis; a level has ⌈samples / 2ⁿ⌉ of them. Between its samples a
    level is linear along each axis, and constant beyond the last one.

    Attributes
    ----------
    brick : samples along the side of a stored brick, the same for all levels; the last one may have fewer
    """

    @property
    def levels(self) -> int: ...

    @property
    def brick(self) -> int: ...

    def level(self, number: int) -> Source: ...

    def bounds(self, number: int) -> NDArray[np.float64]:
        """Return minimum, maximum and error of each brick of a level, float64 (3, bz, by, bx).

        Bricks partition the samples: brick k begins with sample k · `brick`. The error is the largest difference
        between the volume that was stored and what the level stands for, up to the first samples of the next bricks.
        It is inf where only one of both is finite. Brick extremes are +inf and −inf if no sample is finite.
        """
        ...


class SeriesSource(Source, Protocol):
    """Volume at one of several time steps, which knows the others."""

    def at_time(self, time: int) -> Source: ...

    def is_same(self, other: Source, begin_zyx: Index, end_zyx: Index) -> bool:
        """Return whether a box of samples is known to be the same at another time step."""
        ...


def levels_of(source: Source) -> MultilevelSource | None:
    """Return a source as one with levels; None if it has none."""
    return source if getattr(source, "levels", 0) else None  # type: ignore[return-value]
