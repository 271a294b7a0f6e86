"""Information on a volume that completes a scene: grid, origin of the data, statistics of the values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.content.facts import Facts, range_around

THIN = 1 / 8
"""Share of the second longest side of a box below which the shortest makes it thin."""
MOST_EXACT = 2.0**53
"""Up to which float64 holds all whole numbers."""
ALONG_AXIS = 0.999
"""Component of a slice's normal from which on it is along that axis."""


@dataclass(frozen=True, eq=False)
class VolumeInfo(Facts):
    """Grid and value statistics of a volume.

    Attributes
    ----------
    shape_zyx : samples along z, y, x
    spacing : distance of samples along x, y, z, world units
    corners : float64 (8, 3), corners of the volume's box, world
    minimum, maximum, percentile_1, percentile_99 : data values; undefined if the volume has no finite sample
    finite : number of samples that are neither NaN nor infinite
    orientation, modality : see `clusterviz.data.source.Grid`
    is_integer : whether the samples have an integer type
    histogram : int64 (bins,), equal bins from minimum to maximum
    percentiles : pairs (q, value), exact
    blocks : float64 (2, z, y, x), minimum and maximum of each block; the last along an axis may be smaller
    block_sides : sides of a block along z, y and x, cells
    values, counts : (n,), int64 (n,), distinct values, float64 or 64-bit integers, and their numbers of samples; None
        if the samples are not whole numbers, or have too many distinct values
    equal_share : share of equal pairs among neighbouring samples that do not both have the most frequent value
    jump_share : share of pairs that differ by more than 1 among unequal neighbouring samples
    parts : keys of a volume, array, time and channel, for the parts of the file that were chosen
    rows_down : whether the first row of a slice is its upper one, as in pictures
    array : name of the array in the file; "" if it has none
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
    modality: str = ""
    is_integer: bool = False
    histogram: NDArray[np.int64] | None = None
    percentiles: tuple[tuple[float, float], ...] = ()
    blocks: NDArray[np.float64] | None = None
    block_sides: tuple[int, int, int] = (1, 1, 1)
    values: NDArray[np.number[Any]] | None = None
    counts: NDArray[np.int64] | None = None
    equal_share: float = 0.0
    jump_share: float = 0.0
    parts: Mapping[str, Any] = field(default_factory=dict)
    rows_down: bool = False
    array: str = ""

    @property
    def smallest_spacing(self) -> float:
        """Smallest distance of samples, world units."""
        return min(self.spacing)

    @property
    def has_histogram(self) -> bool:
        """Whether the values have a distribution: some are finite, and not all are equal."""
        return self.histogram is not None and bool(self.histogram.any()) and self.minimum < self.maximum

    @property
    def exceeds_floats(self) -> bool:
        """Whether the samples are whole numbers that float64 does not tell apart: ids, not measured values."""
        return self.is_integer and max(-self.minimum, self.maximum) > MOST_EXACT

    @property
    def is_acquired(self) -> bool:
        """Whether the data are acquired, not simulated: integers, or a file that knows of a body or a modality."""
        return self.is_integer or bool(self.orientation or self.modality)

    @property
    def is_flat(self) -> bool:
        """Whether the volume is one layer of cells, as slices and pictures are: all of it is on the layer's faces."""
        return min(self.shape_zyx) <= 2

    @property
    def normal(self) -> NDArray[np.float64] | None:
        """Unit normal of a slice, float64 (3,), its largest component positive; None of a volume, and of a cube."""
        edges = self.corners[[1, 2, 4]] - self.corners[0]
        lengths = np.linalg.norm(edges, axis=1)
        thin, wide, widest = np.argsort(lengths)
        if not self.is_flat or not lengths[thin] < lengths[wide]:
            return None
        across: NDArray[np.float64] = np.cross(edges[wide] / lengths[wide], edges[widest] / lengths[widest])
        across *= np.sign(across[np.abs(across).argmax()]) / np.linalg.norm(across)
        return across

    @property
    def thin_axis(self) -> int | None:
        """Axis of the world, 0 to 2, along which the box is thin; None if it is not thin along exactly one."""
        if self.normal is not None:
            axis = int(self.normal.argmax())
            return axis if self.normal[axis] > ALONG_AXIS else None
        sides = np.ptp(self.corners, axis=0)
        thin, wide, _ = np.argsort(sides)
        return int(thin) if sides[thin] < THIN * sides[wide] else None

    def percentile(self, q: float) -> float:
        """Return a percentile: the exact one if it is known, else as the histogram has it."""
        known = {1.0: self.percentile_1, 99.0: self.percentile_99} | dict(self.percentiles)
        if q in known or not self.has_histogram:
            return known.get(q, self.minimum + q / 100 * (self.maximum - self.minimum))
        shares, edges = self._distribution
        return float(np.interp(q / 100, np.concatenate([[0.0], np.cumsum(shares)]), edges))

    def share(self, low: float, high: float) -> float:
        """Return the share of samples between two values, by the middles of the histogram's bins."""
        if not self.has_histogram:
            return 0.0
        shares, edges = self._distribution
        middles = (edges[1:] + edges[:-1]) / 2
        return float(shares[(middles >= low) & (middles <= high)].sum())

    @property
    def mean_and_deviation(self) -> tuple[float, float]:
        """Mean and standard deviation of the values, by the middles of the histogram's bins."""
        shares, edges = self._distribution
        middles = (edges[1:] + edges[:-1]) / 2
        mean = float(shares @ middles)
        return mean, math.sqrt(float(shares @ (middles - mean) ** 2))

    @property
    def noise(self) -> float:
        """How noisy the values are: about 1 for white noise, below 0.6 for what is smooth over a few samples.

        It is the median range of the blocks' values, as a share of the range expected of as many independent normal
        samples with the deviation of all values.

        References
        ----------
        Blom, Statistical Estimates and Transformed Beta-Variables, 1958: expected extremes of normal samples.
        """
        if self.blocks is None or not self.has_histogram:
            return 0.0
        low, high = self.blocks
        known = high >= low
        _, deviation = self.mean_and_deviation
        samples = math.prod(side + 1 for side in self.block_sides)
        if not known.any() or not deviation:
            return 0.0
        expected = 2 * NormalDist().inv_cdf((samples - 0.375) / (samples + 0.25)) * deviation
        ranges = np.sort((high - low)[known])  # `np.median` would import masked arrays
        return float(ranges[len(ranges) // 2]) / expected

    @property
    def foreground(self) -> tuple[float, float]:
        """Otsu's threshold, and the 98th percentile of the values above it.

        The brightest 1 % are clipped first, since few very bright samples raise the threshold far.

        References
        ----------
        Otsu, A threshold selection method from gray-level histograms, IEEE Transactions on Systems, Man, and
        Cybernetics, 1979.
        """
        share, edges = self._distribution
        top = int(np.searchsorted(np.cumsum(share), 0.99))
        clipped = share[: top + 1].copy()
        clipped[top] += share[top + 1 :].sum()
        cut = _otsu(clipped if top > 8 else share)
        above = np.cumsum(share[cut + 1 :])
        last = cut + 1 + int(np.searchsorted(above, 0.98 * above[-1])) if len(above) else cut
        return float(edges[cut + 1]), float(edges[last + 1])

    @property
    def _distribution(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Share of the samples in each bin of the histogram, float64 (bins,), and the bins' ends, (bins + 1,)."""
        assert self.histogram is not None
        bins = self.histogram.astype(np.float64)
        places = np.arange(len(bins) + 1) / len(bins)
        return bins / bins.sum(), self.minimum * (1 - places) + self.maximum * places


def _otsu(share: NDArray[np.float64]) -> int:
    below, means = np.cumsum(share), np.cumsum(share * np.arange(len(share)))
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (means[-1] * below - means) ** 2 / (below * (1 - below))
    return int(np.nan_to_num(between[:-1]).argmax())


def default_clim(info: VolumeInfo) -> tuple[float, float]:
    """Return the 1st and 99th percentile, the whole range if they are equal, or a range around a constant."""
    for low, high in ((info.percentile_1, info.percentile_99), (info.minimum, info.maximum)):
        if math.isfinite(low) and math.isfinite(high) and low < high:
            return float(low), float(high)
    return range_around(next((v for v in (info.percentile_1, info.minimum) if math.isfinite(v)), 0.0))
