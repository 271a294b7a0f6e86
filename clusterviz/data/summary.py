"""What a volume holds, counted while its bricks are read: extremes of each brick, a histogram, percentiles.

Everything is made of integer counts and of extremes, so the result is the same however the bricks are cut or dealt to
ranks. Percentiles are exact for every type: see `clusterviz.data.selection`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.selection import DIGITS, Counts, count, keys_of, select, shifts_of, values_of
from clusterviz.data.source import Index

Bricks = Callable[[], Iterator[tuple[Index, NDArray[Any]]]]
AllGather = Callable[[Any], list[Any]]

HISTOGRAM_BINS = 256
BATCH = 1 << 18
PERCENTILES = (0.1, 1.0, 2.0, 5.0, 25.0, 50.0, 75.0, 95.0, 98.0, 99.0, 99.9)


@dataclass(frozen=True)
class VolumeSummary:
    """What a volume holds; NaN and ±inf count as invalid and are left out of everything else.

    Attributes
    ----------
    minimum, maximum : float64 (z, y, x bricks); of each brick's samples, the overlap included; +inf and −inf where none
        is finite
    has_invalid : bool (z, y, x bricks); the brick or its overlap holds a NaN or ±inf
    histogram : int64 (bins,); every finite sample of the volume once, in equal bins over `value_range`, the last closed
    value_range : smallest and largest finite sample; (0, 1) where there is none
    percentiles : pairs (q, value)
    """

    minimum: NDArray[np.float64]
    maximum: NDArray[np.float64]
    has_invalid: NDArray[np.bool_]
    histogram: Counts
    value_range: tuple[float, float]
    percentiles: tuple[tuple[float, float], ...]

    def percentile(self, q: float) -> float:
        """The exact percentile, linear between neighbouring samples as in `numpy.percentile`.

        A volume without a finite sample counts as spread evenly over [0, 1].

        Raises
        ------
        ValueError
            `q` was not counted; 0 and 100 always are.
        """
        known = dict(self.percentiles)
        if q not in known:
            raise ValueError(f"percentile {q} was not counted; known are {sorted(known)}")
        return known[q]


def summarise(
    source_dtype: np.dtype[Any],
    layout: BrickLayout,
    bricks: Bricks,
    allgather: AllGather,
    *,
    bins: int = HISTOGRAM_BINS,
    percentiles: Sequence[float] = PERCENTILES,
) -> VolumeSummary:
    """Summarise a volume whose bricks are held by several ranks, each brick by one; collective.

    Parameters
    ----------
    source_dtype : dtype of the samples
    layout : how the volume is cut
    bricks : yields this rank's bricks with their overlap; called once for types of 8 and 16 bits, up to twice for 32
        and four times for 64
    allgather : shares one picklable value with all ranks, and returns those of all ranks
    bins : of the histogram
    percentiles : which to find, 0 to 100

    Raises
    ------
    ValueError
        The ranks' bricks do not make up the volume: one is missing, or held twice.
    """
    shifts = shifts_of(source_dtype)
    extremes, counts = _first_pass(layout, bricks, allgather, shifts[0])
    minimum, maximum, has_invalid = extremes
    finite = int(counts.sum())
    asked = sorted({0.0, 100.0, *map(float, percentiles)})
    if not finite:
        found = tuple((q, q / 100) for q in asked)
        return VolumeSummary(minimum, maximum, has_invalid, np.zeros(bins, np.int64), (0.0, 1.0), found)
    value_range = float(minimum.min()), float(maximum.max())
    if len(shifts) == 1:
        histogram = _rebinned(counts[0], source_dtype, value_range, bins)
    ranks = sorted({rank for q in asked for rank in _neighbours(finite, q)[:2]})
    selection = select(ranks).narrow(counts)
    for shift in shifts[1:]:
        wanted = selection.bins
        mine = np.zeros((len(wanted), DIGITS), np.int64)
        linear = np.zeros(bins, np.int64)
        for samples in _batched(_owned_finite(layout, bricks)):
            mine += count(keys_of(samples), wanted, shift)
            if shift == shifts[1]:
                linear += _linear_counts(samples, value_range, bins)
        shared = allgather((_sparse(mine), linear))
        selection = selection.narrow(_sum_sparse([part[0] for part in shared], len(wanted)))
        if shift == shifts[1]:
            histogram = np.sum([part[1] for part in shared], axis=0)
    values = dict(zip(ranks, values_of(selection.prefixes, source_dtype).tolist(), strict=True))
    found = tuple((q, _between(values, *_neighbours(finite, q))) for q in asked)
    return VolumeSummary(minimum, maximum, has_invalid, histogram, value_range, found)


def _first_pass(
    layout: BrickLayout, bricks: Bricks, allgather: AllGather, shift: int
) -> tuple[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]], Counts]:
    """Extremes and validity of each brick, and the counts (1, DIGITS) of the leading digit over the volume."""
    mine = np.zeros((1, DIGITS), np.int64)
    rows, owned = [], 0

    def finite_parts() -> Iterator[NDArray[Any]]:
        nonlocal owned
        for index, samples in bricks():
            finite = _finite(samples)
            low, high = (finite.min(), finite.max()) if finite.size else (np.inf, -np.inf)
            rows.append((index, float(low), float(high), finite.size < samples.size))
            part = _owned(layout, index, samples)
            owned += part.size
            yield _finite(part)

    for samples in _batched(finite_parts()):
        mine += count(keys_of(samples), np.zeros(1, np.uint64), shift)
    shared = allgather((rows, owned, _sparse(mine)))
    total, samples_in_volume = sum(part[1] for part in shared), prod(layout.shape_zyx)
    if total != samples_in_volume:
        raise ValueError(f"the ranks' bricks hold {total} samples, the volume {samples_in_volume}")
    minimum, maximum = np.full(layout.counts_zyx, np.inf), np.full(layout.counts_zyx, -np.inf)
    has_invalid = np.zeros(layout.counts_zyx, bool)
    for index, low, high, invalid in (row for part in shared for row in part[0]):
        minimum[index], maximum[index], has_invalid[index] = low, high, invalid
    return (minimum, maximum, has_invalid), _sum_sparse([part[2] for part in shared], 1)


def _owned(layout: BrickLayout, index: Index, samples: NDArray[Any]) -> NDArray[Any]:
    """The brick without the layers that belong to its neighbours."""
    begin, end = layout.owned_box(index)
    z, y, x = np.subtract(end, begin) + layout.margin
    return samples[layout.margin : z, layout.margin : y, layout.margin : x]


def _finite(samples: NDArray[Any]) -> NDArray[Any]:
    """1-D: the finite samples."""
    if samples.dtype.kind != "f":
        return samples.ravel()
    if samples.size and np.isfinite(samples.min()) and np.isfinite(samples.max()):  # NaN spreads to both
        return samples.ravel()
    return np.asarray(samples[np.isfinite(samples)])


def _owned_finite(layout: BrickLayout, bricks: Bricks) -> Iterator[NDArray[Any]]:
    for index, samples in bricks():
        yield _finite(_owned(layout, index, samples))


def _batched(parts: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """Samples (n,) of several bricks at once: counting those of a small one takes as long as `BATCH` samples."""
    waiting, held = list[NDArray[Any]](), 0
    for part in parts:
        waiting.append(part)
        held += part.size
        if held >= BATCH:
            yield np.concatenate(waiting)
            waiting, held = [], 0
    if waiting:
        yield np.concatenate(waiting)


def _linear_counts(samples: NDArray[Any], value_range: tuple[float, float], bins: int) -> Counts:
    return np.bincount(_linear_bins(samples, value_range, bins), minlength=bins).astype(np.int64, copy=False)


def _linear_bins(samples: NDArray[Any], value_range: tuple[float, float], bins: int) -> NDArray[np.intp]:
    """In which of the equal bins over `value_range` each sample lies; halved first, lest the width overflow."""
    low, high = value_range
    if high == low:
        return np.zeros(samples.shape, np.intp)
    scale = 1.0 if abs(low) < 1e300 and abs(high) < 1e300 else 0.25
    part = samples.astype(np.float64)
    part *= scale
    part -= low * scale
    part /= high * scale - low * scale
    part *= bins
    return np.minimum(part.astype(np.intp), bins - 1)


def _rebinned(counts: Counts, dtype: np.dtype[Any], value_range: tuple[float, float], bins: int) -> Counts:
    """The linear histogram of a type whose every value was counted."""
    keys = np.flatnonzero(counts)
    histogram = np.zeros(bins, np.int64)
    np.add.at(histogram, _linear_bins(values_of(keys, dtype), value_range, bins), counts[keys])
    return histogram


def _neighbours(samples: int, q: float) -> tuple[int, int, float]:
    """The two ranks between which percentile `q` lies, and how far from the first to the second; in exact fractions."""
    position = Fraction(samples - 1) * Fraction(q) / 100
    below = position.numerator // position.denominator
    return below, ceil(position), float(position - below)


def _between(values: dict[int, float], below: int, above: int, part: float) -> float:
    low, high = values[below], values[above]
    return low if low == high else low * (1 - part) + high * part


def _sparse(counts: Counts) -> tuple[NDArray[np.int64], Counts]:
    """Most of the counts are 0, and every rank receives those of all."""
    where = np.flatnonzero(counts)
    return where, counts.ravel()[where]


def _sum_sparse(parts: Sequence[tuple[NDArray[np.int64], Counts]], rows: int) -> Counts:
    total = np.zeros(rows * DIGITS, np.int64)
    for where, counts in parts:
        total[where] += counts
    return total.reshape(rows, DIGITS)
