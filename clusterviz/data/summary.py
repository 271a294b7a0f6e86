"""Summary of a volume: extremes of bricks and blocks, histogram, percentiles and categories.

It is computed while bricks are read, from integer counts and extremes only, so it does not depend on how bricks are
divided or assigned to ranks. Percentiles are exact for every type: see `clusterviz.data.order_statistics`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.order_statistics import DIGITS, Counts, begin_selection, count, keys_of, shifts_of, values_of
from clusterviz.data.source import Index, Source, as_index

Bricks = Callable[[], Iterator[tuple[Index, NDArray[Any]]]]
AllGather = Callable[[Any], list[Any]]
Sparse = tuple[NDArray[np.int64], Counts]

HISTOGRAM_BINS = 256
BATCH = 1 << 18
PERCENTILES = (0.1, 1.0, 2.0, 5.0, 25.0, 50.0, 75.0, 95.0, 98.0, 99.0, 99.9)
CATEGORY_SAMPLES = 1 << 20
"""Approximate number of samples whose values are counted, in whole layers along z."""
MAX_VALUES = 2048
BLOCKS = 32
"""Maximum number of blocks along an axis; unlike bricks, blocks do not depend on the layout."""


@dataclass(frozen=True)
class Categories:
    """Whole numbers that may be categories, counted in some layers along z that depend on the volume only.

    Attributes
    ----------
    values : (n,), ascending; float64, or the type of samples of 64-bit integers, which floats do not hold
    counts : int64 (n,), samples of each value
    equal : int64 (n,), pairs of neighbours along x that both have the value
    pairs, jumps : pairs of neighbours along x, and those that differ by more than 1
    """

    values: NDArray[Any]
    counts: Counts
    equal: Counts
    pairs: int
    jumps: int


@dataclass(frozen=True)
class VolumeSummary:
    """Extremes, histogram and percentiles of a volume; NaN and ±inf are invalid and only counted as such.

    Attributes
    ----------
    minimum, maximum : float64 (z, y, x bricks); of each brick's samples with the overlap; +inf and −inf if none is
        finite
    histogram : int64 (bins,); every finite sample of the volume once, in equal bins over `value_range`, the last closed
    value_range : smallest and largest finite sample; (0, 1) if there is none
    percentiles : pairs (q, value)
    blocks : float64 (2, z, y, x blocks); extremes of blocks of `block_sides` cells with the samples around them; +inf
        and −inf if none is finite
    categories : None if a sample is not a whole number, or there are more than `MAX_VALUES` values
    """

    minimum: NDArray[np.float64]
    maximum: NDArray[np.float64]
    histogram: Counts
    value_range: tuple[float, float]
    percentiles: tuple[tuple[float, float], ...]
    blocks: NDArray[np.float64] | None = None
    categories: Categories | None = None

    def percentile(self, q: float) -> float:
        """Return an exact percentile, linear between neighbouring samples as in `numpy.percentile`.

        The samples of a volume without finite ones count as uniform over [0, 1].

        Raises
        ------
        ValueError
            `q` was not counted; 0 and 100 always are.
        """
        known = dict(self.percentiles)
        if q not in known:
            raise ValueError(f"percentile {q} was not counted; known are {sorted(known)}")
        return known[q]


def kept_summary(source: Source, layout: BrickLayout) -> VolumeSummary | None:
    """Return the summary that a source keeps, whose extremes of bricks may be wider; None: there is none."""
    inner: Any = source
    while hasattr(inner, "source"):  # wrapped by a guard or another grid
        inner = inner.source
    found: VolumeSummary | None = inner.summary(layout) if hasattr(inner, "summary") else None
    return found


def summary_over_time(summaries: Sequence[VolumeSummary]) -> VolumeSummary:
    """Return one summary of a volume's time steps, for colours and a camera that suit all of them.

    Extremes are those of all steps, and so are percentiles: the least below 50, the greatest from there on. The samples
    of a bin of a histogram count as its middle.
    """
    summaries = [each for each in summaries if each.histogram.any()] or summaries[:1]
    first = summaries[0]
    low, high = min(each.value_range[0] for each in summaries), max(each.value_range[1] for each in summaries)
    histogram = np.zeros(len(first.histogram), np.int64)
    for each in summaries:
        edges = np.linspace(*each.value_range, len(each.histogram) + 1)
        np.add.at(histogram, _linear_bins((edges[1:] + edges[:-1]) / 2, (low, high), len(histogram)), each.histogram)
    found = zip(*(each.percentiles for each in summaries), strict=True)
    percentiles = tuple(
        (q, (min if q < 50 else max)(value for _, value in pairs)) for pairs in found for q, _ in pairs[:1]
    )
    return VolumeSummary(
        np.min([each.minimum for each in summaries], axis=0),
        np.max([each.maximum for each in summaries], axis=0),
        histogram,
        (low, high),
        percentiles,
        _blocks_over_time([each.blocks for each in summaries if each.blocks is not None]),
        _merge_categories([each.categories for each in summaries]),
    )


def _blocks_over_time(blocks: Sequence[NDArray[np.float64]]) -> NDArray[np.float64] | None:
    lows, highs = ([each[side] for each in blocks] for side in (0, 1))
    return np.stack([np.min(lows, axis=0), np.max(highs, axis=0)]) if blocks else None


def summarise(
    source_dtype: np.dtype[Any],
    layout: BrickLayout,
    bricks: Bricks,
    allgather: AllGather,
    *,
    bins: int = HISTOGRAM_BINS,
    percentiles: Sequence[float] = PERCENTILES,
) -> VolumeSummary:
    """Summarise a volume whose bricks are distributed over ranks, each brick on one; collective.

    Parameters
    ----------
    source_dtype : dtype of the samples
    bricks : yields this rank's bricks with their overlap; called once for types of 8 and 16 bits, up to twice for 32
        and four times for 64
    allgather : shares one picklable value with all ranks, and returns those of all ranks

    Raises
    ------
    ValueError
        The ranks' bricks do not make up the volume: one is missing, or on two ranks.
    """
    shifts = shifts_of(source_dtype)
    parts = allgather(_count_part(layout, bricks, shifts[0]))
    counts, first = _sum_sparse([part.counts for part in parts], 1), _merge_parts(layout, parts, bins)
    finite = int(counts.sum())
    asked = sorted({0.0, 100.0, *map(float, percentiles)})
    if not finite:
        return replace(first, percentiles=tuple((q, q / 100) for q in asked))
    value_range = float(first.minimum.min()), float(first.maximum.max())
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
    return replace(first, histogram=histogram, value_range=value_range, percentiles=found)


@dataclass(frozen=True)
class _Part:
    """First pass over the bricks of one rank."""

    bricks: list[tuple[Index, float, float]]  # index, minimum and maximum
    samples: int  # that the bricks own
    counts: Sparse  # of the leading digit
    blocks: tuple[NDArray[np.int64], NDArray[np.float64]]  # flat indices of those met (n,), and their extremes (2, n)
    categories: Categories | None


def _count_part(layout: BrickLayout, bricks: Bricks, shift: int) -> _Part:
    """Count the leading digits of this rank's samples, and note extremes and categories of its bricks."""
    blocks, categories = _empty_blocks(layout), _CategoryCounter(layout)
    extremes, owned = [], 0

    def finite_samples() -> Iterator[NDArray[Any]]:
        nonlocal owned
        for index, samples in bricks():
            extremes.append((index, *_update_blocks(blocks, layout, index, samples)))
            categories.add(index, samples)
            own = _owned(layout, index, samples)
            owned += own.size
            yield _finite(own)

    counts = np.zeros((1, DIGITS), np.int64)
    for batch in _batched(finite_samples()):
        counts += count(keys_of(batch), np.zeros(1, np.uint64), shift)
    met = np.flatnonzero(blocks[1] >= blocks[0])
    return _Part(extremes, owned, _sparse(counts), (met, blocks.reshape(2, -1)[:, met]), categories.found)


def _merge_parts(layout: BrickLayout, parts: Sequence[_Part], bins: int) -> VolumeSummary:
    """Merge the parts of all ranks, whose samples are not counted yet."""
    held, samples = sum(part.samples for part in parts), prod(layout.shape_zyx)
    if held != samples:
        raise ValueError(f"the ranks' bricks hold {held} samples, the volume {samples}")
    minimum, maximum = np.full(layout.counts_zyx, np.inf), np.full(layout.counts_zyx, -np.inf)
    blocks = _empty_blocks(layout)
    low_of, high_of = blocks.reshape(2, -1)
    for part in parts:
        for index, low, high in part.bricks:
            minimum[index], maximum[index] = low, high
        met, (lows, highs) = part.blocks
        low_of[met] = np.minimum(low_of[met], lows)
        high_of[met] = np.maximum(high_of[met], highs)
    categories = _merge_categories([part.categories for part in parts])
    return VolumeSummary(minimum, maximum, np.zeros(bins, np.int64), (0.0, 1.0), (), blocks, categories)


def block_sides(shape_zyx: Index) -> Index:
    """Return the cells along the sides of a volume's blocks."""
    return as_index(-(-max(1, n - 1) // BLOCKS) for n in shape_zyx)


def block_counts(shape_zyx: Index) -> Index:
    return as_index(-(-max(1, n - 1) // side) for n, side in zip(shape_zyx, block_sides(shape_zyx), strict=True))


def _empty_blocks(layout: BrickLayout) -> NDArray[np.float64]:
    """Return the extremes of blocks without samples, float64 (2, z, y, x blocks): +inf and −inf."""
    blocks = np.empty((2, *block_counts(layout.shape_zyx)))
    blocks[0], blocks[1] = np.inf, -np.inf
    return blocks


def _update_blocks(
    blocks: NDArray[np.float64], layout: BrickLayout, index: Index, samples: NDArray[Any]
) -> tuple[float, float]:
    """Widen the extremes of the blocks that a brick meets; return the smallest and the largest finite sample."""
    (begin, _), margin = layout.cell_box(index), layout.margin
    # A margin before the volume repeats the first samples.
    samples = samples[tuple(slice(max(0, margin - b), None) for b in begin)]
    lower = upper = samples
    low, high = samples.min(), samples.max()
    if not (np.isfinite(low) and np.isfinite(high)):  # NaN spreads to both
        finite = np.isfinite(samples)
        lower, upper = np.where(finite, samples, np.inf), np.where(finite, samples, -np.inf)
        low, high = lower.min(), upper.max()
    region: list[slice] = []
    for axis, side in enumerate(block_sides(layout.shape_zyx)):
        first, size = max(0, begin[axis] - margin), samples.shape[axis]
        met = range(first // side, min(blocks.shape[1 + axis], -(-(first + size) // side)))
        # Neighbouring blocks share a layer of samples.
        layers = [slice(max(0, block * side - first), (block + 1) * side + 1 - first) for block in met]
        lower, upper = _reduce(np.min, lower, axis, layers), _reduce(np.max, upper, axis, layers)
        region.append(slice(met.start, met.stop))
    low_of, high_of = blocks[0][tuple(region)], blocks[1][tuple(region)]
    np.minimum(low_of, lower, out=low_of)
    np.maximum(high_of, upper, out=high_of)
    return float(low), float(high)


def _reduce(
    extreme: Callable[..., NDArray[Any]], samples: NDArray[Any], axis: int, layers: Sequence[slice]
) -> NDArray[Any]:
    before = (slice(None),) * axis
    return np.stack([extreme(samples[(*before, part)], axis=axis) for part in layers], axis=axis)


class _CategoryCounter:
    """Counter of the values in some layers along z; `found` is None once they are no categories."""

    def __init__(self, layout: BrickLayout) -> None:
        self._layout, self._stride = layout, max(1, round(prod(layout.shape_zyx) / CATEGORY_SAMPLES))
        self.found: Categories | None = Categories(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64), 0, 0)

    def add(self, index: Index, samples: NDArray[Any]) -> None:
        """Count the samples that a brick owns in these layers."""
        if self.found is None:
            return
        margin, ((z, y, x), (z_end, y_end, x_end)) = self._layout.margin, self._layout.owned_box(index)
        layers = slice(margin + -z % self._stride, margin + z_end - z, self._stride)
        # One sample more along x, of the overlap, is the neighbour of the last.
        after = min(x_end + 1, self._layout.shape_zyx[2])
        wide = samples[layers, margin : margin + y_end - y, margin : margin + after - x]
        own = wide[..., : x_end - x]
        if not own.size:
            return
        if own.dtype.kind == "f" and not (np.isfinite(own) & (own == np.rint(own))).all():
            self.found = None
            return
        values, counts = np.unique(own, return_counts=True)
        with np.errstate(over="ignore"):  # of the widest floats
            steps = np.abs(np.diff(wide.astype(np.float64), axis=2))
        equal_values, times = np.unique(wide[..., :-1][wide[..., 1:] == wide[..., :-1]], return_counts=True)
        equal = np.zeros(len(values), np.int64)
        equal[np.searchsorted(values, equal_values)] = times
        is_wide = values.dtype.kind in "iu" and values.dtype.itemsize == 8
        here = Categories(
            values if is_wide else values.astype(np.float64), counts, equal, steps.size, int((steps > 1).sum())
        )
        self.found = _merge_categories([self.found, here])


def _merge_categories(parts: Sequence[Categories | None]) -> Categories | None:
    """Return the sum of several counts; None if one is None or there are too many values."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    held = [part.values for part in known if len(part.values)] or [np.zeros(0)]
    values, where = np.unique(np.concatenate(held), return_inverse=True)
    if len(values) > MAX_VALUES:
        return None
    counts, equal = np.zeros((2, len(values)), np.int64)
    np.add.at(counts, where, np.concatenate([part.counts for part in known]))
    np.add.at(equal, where, np.concatenate([part.equal for part in known]))
    return Categories(values, counts, equal, sum(part.pairs for part in known), sum(part.jumps for part in known))


def _owned(layout: BrickLayout, index: Index, samples: NDArray[Any]) -> NDArray[Any]:
    """Return the samples that a brick owns, without its overlap."""
    begin, end = layout.owned_box(index)
    z, y, x = np.subtract(end, begin) + layout.margin
    return samples[layout.margin : z, layout.margin : y, layout.margin : x]


def _finite(samples: NDArray[Any]) -> NDArray[Any]:
    if samples.dtype.kind != "f":
        return samples.ravel()
    if samples.size and np.isfinite(samples.min()) and np.isfinite(samples.max()):  # NaN spreads to both
        return samples.ravel()
    return np.asarray(samples[np.isfinite(samples)])


def _owned_finite(layout: BrickLayout, bricks: Bricks) -> Iterator[NDArray[Any]]:
    for index, samples in bricks():
        yield _finite(_owned(layout, index, samples))


def _batched(parts: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """Join samples of small bricks to batches (n,): counting fewer than `BATCH` samples takes as long as `BATCH`."""
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
    """Return the bin of each sample, of equal bins over `value_range`; wide ranges are scaled to avoid overflow."""
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
    keys = np.flatnonzero(counts)
    histogram = np.zeros(bins, np.int64)
    np.add.at(histogram, _linear_bins(values_of(keys, dtype), value_range, bins), counts[keys])
    return histogram


def _neighbours(samples: int, q: float) -> tuple[int, int, float]:
    """Return the two ranks around percentile `q`, and the exact position between them."""
    position = Fraction(samples - 1) * Fraction(q) / 100
    below = position.numerator // position.denominator
    return below, ceil(position), float(position - below)


def _between(values: dict[int, float], below: int, above: int, part: float) -> float:
    low, high = values[below], values[above]
    return low if low == high else low * (1 - part) + high * part


def _sparse(counts: Counts) -> Sparse:
    """Return the counts that are not 0, with their flat indices; few are not, and every rank receives those of all."""
    where = np.flatnonzero(counts)
    return where, counts.ravel()[where]


def _sum_sparse(parts: Sequence[Sparse], rows: int) -> Counts:
    total = np.zeros(rows * DIGITS, np.int64)
    for where, counts in parts:
        total[where] += counts
    return total.reshape(rows, DIGITS)
