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
from clusterviz.data.order_statistics import DIGITS, Counts, begin_selection, count, keys_of, shifts_of, values_of
from clusterviz.data.source import Index

Bricks = Callable[[], Iterator[tuple[Index, NDArray[Any]]]]
AllGather = Callable[[Any], list[Any]]

HISTOGRAM_BINS = 256
BATCH = 1 << 18
PERCENTILES = (0.1, 1.0, 2.0, 5.0, 25.0, 50.0, 75.0, 95.0, 98.0, 99.0, 99.9)


CATEGORY_SAMPLES = 1 << 20
"""Samples, about, of which the values are counted; every layer along z where the volume has fewer."""
MAX_VALUES = 2048
BLOCKS = 32
"""Blocks along an axis at most, whose extremes are kept; unlike bricks they are the same for every layout."""


@dataclass(frozen=True)
class Categories:
    """Whole numbers that may be categories, from some layers along z, whatever bricks and ranks are.

    Attributes
    ----------
    values : float64 (n,), ascending
    counts : int64 (n,), samples of each
    equal : int64 (n,), of each value, neighbours along x that both have it
    pairs, jumps : neighbours along x, and those that differ by more than 1
    """

    values: NDArray[np.float64]
    counts: Counts
    equal: Counts
    pairs: int
    jumps: int


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
    blocks : float64 (2, z, y, x blocks); the extremes of blocks of `block_sides` cells, the samples around them
        included; +inf and −inf where none is finite
    categories : None where some sample is not a whole number, or there are more than `MAX_VALUES` values
    """

    minimum: NDArray[np.float64]
    maximum: NDArray[np.float64]
    has_invalid: NDArray[np.bool_]
    histogram: Counts
    value_range: tuple[float, float]
    percentiles: tuple[tuple[float, float], ...]
    blocks: NDArray[np.float64] | None = None
    categories: Categories | None = None

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
    extremes, counts, content = _first_pass(layout, bricks, allgather, shifts[0])
    minimum, maximum, has_invalid = extremes
    finite = int(counts.sum())
    asked = sorted({0.0, 100.0, *map(float, percentiles)})
    if not finite:
        found = tuple((q, q / 100) for q in asked)
        return VolumeSummary(minimum, maximum, has_invalid, np.zeros(bins, np.int64), (0.0, 1.0), found, *content)
    value_range = float(minimum.min()), float(maximum.max())
    if len(shifts) == 1:
        histogram = _rebinned(counts[0], source_dtype, value_range, bins)
    ranks = sorted({rank for q in asked for rank in _neighbours(finite, q)[:2]})
    selection = begin_selection(ranks).narrow(counts)
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
    return VolumeSummary(minimum, maximum, has_invalid, histogram, value_range, found, *content)


def _first_pass(
    layout: BrickLayout, bricks: Bricks, allgather: AllGather, shift: int
) -> tuple[
    tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]],
    Counts,
    tuple[NDArray[np.float64], Categories | None],
]:
    """Extremes and validity of each brick, the counts (1, DIGITS) of the leading digit, blocks and categories."""
    mine = np.zeros((1, DIGITS), np.int64)
    sides = block_sides(layout.shape_zyx)
    blocks = np.empty((2, *(-(-n // side) for n, side in zip(layout.cells_zyx, sides, strict=True))))
    blocks[0], blocks[1] = np.inf, -np.inf
    values = _CategoryCounter(layout)
    rows, owned = [], 0

    def finite_parts() -> Iterator[NDArray[Any]]:
        nonlocal owned
        for index, samples in bricks():
            rows.append((index, *_update_blocks(blocks, sides, layout, index, samples)))
            values.add(index, samples)
            part = _owned(layout, index, samples)
            owned += part.size
            yield _finite(part)

    for samples in _batched(finite_parts()):
        mine += count(keys_of(samples), np.zeros(1, np.uint64), shift)
    met = np.flatnonzero(blocks[1] >= blocks[0])
    shared = allgather((rows, owned, _sparse(mine), (met, blocks.reshape(2, -1)[:, met]), values.found))
    total, samples_in_volume = sum(part[1] for part in shared), prod(layout.shape_zyx)
    if total != samples_in_volume:
        raise ValueError(f"the ranks' bricks hold {total} samples, the volume {samples_in_volume}")
    minimum, maximum = np.full(layout.counts_zyx, np.inf), np.full(layout.counts_zyx, -np.inf)
    has_invalid = np.zeros(layout.counts_zyx, bool)
    for index, low, high, invalid in (row for part in shared for row in part[0]):
        minimum[index], maximum[index], has_invalid[index] = low, high, invalid
    low_of, high_of = blocks.reshape(2, -1)
    for where, (low, high) in (part[3] for part in shared):
        np.minimum.at(low_of, where, low)
        np.maximum.at(high_of, where, high)
    found = _merge_categories([part[4] for part in shared])
    return (minimum, maximum, has_invalid), _sum_sparse([part[2] for part in shared], 1), (blocks, found)


def block_sides(shape_zyx: Index) -> Index:
    """Cells along the sides of the blocks of a volume."""
    z, y, x = (-(-max(1, n - 1) // BLOCKS) for n in shape_zyx)
    return z, y, x


def _update_blocks(
    blocks: NDArray[np.float64], sides: Index, layout: BrickLayout, index: Index, samples: NDArray[Any]
) -> tuple[float, float, bool]:
    """Widen the extremes of the blocks that a brick meets; its own, and whether a sample is not finite."""
    (begin, _), margin = layout.cell_box(index), layout.margin
    skips = tuple(slice(max(0, margin - b), None) for b in begin)  # a margin before the volume repeats its samples
    samples = samples[skips]
    lower = upper = samples
    low, high = samples.min(), samples.max()
    invalid = not (np.isfinite(low) and np.isfinite(high))  # NaN spreads to both
    if invalid:
        finite = np.isfinite(samples)
        lower, upper = np.where(finite, samples, np.inf), np.where(finite, samples, -np.inf)
        low, high = lower.min(), upper.max()
    region: list[slice] = []
    for axis, side in enumerate(sides):
        first, size = max(0, begin[axis] - margin), lower.shape[axis]
        met = range(first // side, min(blocks.shape[1 + axis], -(-(first + size) // side)))
        parts = [slice(max(0, b * side - first), (b + 1) * side + 1 - first) for b in met]
        lower, upper = (
            np.stack([extreme(part_of[(slice(None),) * axis + (part,)], axis=axis) for part in parts], axis=axis)
            for extreme, part_of in ((np.min, lower), (np.max, upper))
        )
        region.append(slice(met.start, met.stop))
    low_of, high_of = blocks[0][tuple(region)], blocks[1][tuple(region)]
    np.minimum(low_of, lower, out=low_of)
    np.maximum(high_of, upper, out=high_of)
    return float(low), float(high), invalid


class _CategoryCounter:
    """Counts the values of some layers along z while bricks are read; `found` is None once they are no categories."""

    def __init__(self, layout: BrickLayout) -> None:
        self._layout, self._stride = layout, max(1, round(prod(layout.shape_zyx) / CATEGORY_SAMPLES))
        self.found: Categories | None = Categories(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64), 0, 0)

    def add(self, index: Index, samples: NDArray[Any]) -> None:
        """Count what a brick owns of these layers."""
        if self.found is None:
            return
        begin = self._layout.owned_box(index)[0][0]
        own = _owned(self._layout, index, samples)[-begin % self._stride :: self._stride]
        if not own.size:
            return
        if own.dtype.kind == "f" and not (np.isfinite(own) & (own == np.rint(own))).all():
            self.found = None
            return
        values, counts = np.unique(own, return_counts=True)
        # The neighbour beyond the brick's last sample is in its overlap.
        margin, (_, y, x), (first, last) = self._layout.margin, own.shape, self._layout.owned_box(index)
        beyond = min(x + 1, self._layout.shape_zyx[2] - first[2])
        wide = samples[margin : margin + last[0] - first[0], margin : margin + y, margin : margin + beyond]
        wide = wide[-begin % self._stride :: self._stride]
        with np.errstate(over="ignore"):  # of the widest floats
            steps = np.abs(np.diff(wide.astype(np.float64), axis=2))
        equal_values, times = np.unique(wide[..., :-1][steps == 0], return_counts=True)
        equal = np.zeros(len(values), np.int64)
        equal[np.searchsorted(values, equal_values)] = times
        here = Categories(values.astype(np.float64), counts, equal, steps.size, int((steps > 1).sum()))
        self.found = _merge_categories([self.found, here])


def _merge_categories(parts: Sequence[Categories | None]) -> Categories | None:
    """The sum of several counts."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    values, where = np.unique(np.concatenate([part.values for part in known]), return_inverse=True)
    if len(values) > MAX_VALUES:
        return None
    counts, equal = np.zeros((2, len(values)), np.int64)
    np.add.at(counts, where, np.concatenate([part.counts for part in known]))
    np.add.at(equal, where, np.concatenate([part.equal for part in known]))
    return Categories(values, counts, equal, sum(part.pairs for part in known), sum(part.jumps for part in known))


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
