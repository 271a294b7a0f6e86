"""Levels of a volume, and the statistics that a store keeps. A level is the low-pass of the linear spline wavelet.

Sample i of a level lies at sample 2i of the next finer one. The low-pass has the weights −1, 2, 6, 2, −1 eighths along
each axis, with samples mirrored beyond the ends: it keeps means, and linear functions away from the ends.

A level stands for the function that is linear between its samples along each axis, and constant beyond the last one.
Such a function on a coarser level is one on a finer level, too. So the difference between two neighbouring levels is
greatest at a sample of the finer one, and differences over several levels add up to a bound.

A store keeps the summary of its finest level, with which a volume is opened without reading it:
OUT.ome.zarr/bricks/statistics.npz   the arrays of a `VolumeSummary`, and their checksum, as of numpy.savez_compressed

References
----------
A. Cohen, I. Daubechies, J.-C. Feauveau: Biorthogonal bases of compactly supported wavelets, Comm. Pure Appl. Math.
45(5), 1992: the wavelet (2, 2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.remote import WHOLE_FILE_BYTES, FilePath, read_range
from clusterviz.data.source import Index, as_index
from clusterviz.data.store.shards import checksum
from clusterviz.data.summary import Categories, VolumeSummary, block_counts
from clusterviz.errors import DataError, guard
from clusterviz.image.replace import replacing

Read = Callable[[Index, Index], NDArray[Any]]
WEIGHTS = (-0.125, 0.25, 0.75)


def coarser(shape_zyx: Index) -> Index:
    return as_index((side + 1) // 2 for side in shape_zyx)


def low_pass(read: Read, shape_zyx: Index, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
    """Return a box of samples of the next coarser level.

    Parameters
    ----------
    begin_zyx, end_zyx : the half-open box of samples of the coarser one

    Returns
    -------
    samples : of the type read, rounded and clamped to its range; NaN where a weighted sample is not finite
    """
    lows = [max(0, 2 * b - 2) for b in begin_zyx]
    highs = [min(n, 2 * e + 1) for e, n in zip(end_zyx, shape_zyx, strict=True)]
    samples = read(as_index(lows), as_index(highs))
    mirrored = [
        _mirrored(np.arange(2 * b - 2, 2 * e + 1), n) - low
        for b, e, n, low in zip(begin_zyx, end_zyx, shape_zyx, lows, strict=True)
    ]
    z, y, x = mirrored
    kind = np.float32 if samples.dtype.kind in "iu" and samples.itemsize == 1 else np.float64  # in which sums are exact
    result = np.empty(np.subtract(end_zyx, begin_zyx), samples.dtype)
    planes: dict[int, NDArray[Any]] = {}
    # Plane by plane, so that sums stay in the cache.
    for i, target in enumerate(result):
        wanted = z[2 * i : 2 * i + 5].tolist()
        planes = {
            n: planes[n] if n in planes else _filtered(_filtered(samples[n], y, 0, kind), x, 1, kind) for n in wanted
        }
        with np.errstate(invalid="ignore", over="ignore"):
            target[...] = _rounded(_weighted([planes[n] for n in wanted]), samples.dtype)
    return result


def _mirrored(indices: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    period = max(1, 2 * count - 2)
    indices = indices % period
    return np.minimum(indices, period - indices) if count > 1 else indices


def _filtered(plane: NDArray[Any], indices: NDArray[np.int64], axis: int, kind: Any) -> NDArray[Any]:
    """Return the low-pass along an axis: of five samples with these indices, of those two further on, and so on."""
    # Every second sample, so that sums run over contiguous memory.
    even, odd = (plane.take(indices[n::2], axis).astype(kind, copy=False) for n in (0, 1))
    count = len(indices) // 2 - 1
    spans = [(even, 0), (odd, 0), (even, 1), (odd, 1), (even, 2)]
    return _weighted([part[n : n + count] if axis == 0 else part[:, n : n + count] for part, n in spans])


def _weighted(parts: list[Any]) -> NDArray[Any]:
    outer, inner, middle = WEIGHTS
    total: NDArray[Any] = outer * (parts[0] + parts[4]) + inner * (parts[1] + parts[3]) + middle * parts[2]
    return total


def _rounded(values: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    with np.errstate(over="ignore"):
        if dtype.kind == "f":
            return values.astype(dtype)
        low, high = (float(limit) for limit in (np.iinfo(dtype).min, np.iinfo(dtype).max))
        if dtype.itemsize == 8:
            high = float(np.nextafter(high, 0))
        rounded: NDArray[Any] = np.clip(np.rint(values), low, high).astype(dtype)
    return rounded


def difference(fine: NDArray[Any], coarse: NDArray[Any]) -> float:
    """Return the largest difference between samples and the interpolated samples of the next coarser level.

    Parameters
    ----------
    fine : (z, y, x), begins at an even index along each axis
    coarse : the samples of the coarser level from the same position, up to the first at or beyond the last one of
        `fine`, or the last one that there is

    Returns
    -------
    largest : inf where only one of both is finite
    """
    kind = np.float32 if fine.dtype.kind in "iu" and fine.itemsize <= 2 else np.float64  # in which means are exact
    largest, behind, ahead = 0.0, np.empty(0), _finer(coarse[0].astype(kind), fine.shape[1:])
    for z, plane in enumerate(fine):
        if z % 2 == 0:
            behind, following = ahead, min(z // 2 + 1, len(coarse) - 1)
            ahead = _finer(coarse[following].astype(kind), fine.shape[1:])
        found = behind if z % 2 == 0 else _mean(behind, ahead)
        largest = max(largest, largest_difference(plane, found))
    return largest


def _finer(plane: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    for count in shape:
        finer = np.empty((count, plane.shape[1]), plane.dtype)
        finer[0::2] = plane[: (count + 1) // 2]
        following = plane[np.minimum(np.arange(count // 2) + 1, len(plane) - 1)]
        finer[1::2] = _mean(plane[: count // 2], following)
        plane = np.ascontiguousarray(finer.T)
    return plane


def _mean(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    with np.errstate(invalid="ignore"):
        mean: NDArray[Any] = a * 0.5 + b * 0.5
    return mean


def largest_difference(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Return the largest difference between finite samples; inf where only one of both is finite."""
    kind = np.result_type(a, b, np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        away = np.abs(a.astype(kind) - b.astype(kind))
    largest = float(away.max())
    if np.isfinite(largest):
        return largest
    if not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return float("inf")
    return float(away[np.isfinite(away)].max(initial=0.0))


def is_within(samples: NDArray[Any], others: NDArray[Any], error: float) -> bool:
    """Return whether samples differ by at most an error, and those that are not finite by no bit."""
    bits = f"u{samples.itemsize}"
    differs = samples.view(bits) != others.view(bits)
    if not differs.any():
        return True
    if error == 0 or (samples.dtype.kind != "f" and samples.itemsize == 8):
        return False
    if samples.dtype.kind != "f":
        return largest_difference(samples, others) <= error
    a, b = samples[differs].astype(np.float64), others[differs].astype(np.float64)
    # Less, since a difference that is rounded may have been greater.
    return bool(np.isfinite(a).all() and np.isfinite(b).all() and np.abs(a - b).max() < error)


MARGIN = 2
"""Samples beyond the corners of a brick's cells that its extremes include; as many as most blend modes need."""


def write_statistics(path: Path, summary: VolumeSummary, layout: BrickLayout) -> None:
    known, arrays = summary.categories, {"layout": [layout.brick, layout.margin]} | _arrays(summary)
    if known:
        arrays |= {f"category_{key}": value for key, value in _arrays(known).items()}
    arrays["checksum"] = _checksum(arrays)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def read_statistics(path: FilePath, layout: BrickLayout, has_checksum: bool = True) -> VolumeSummary:
    """Return the summary of a volume; extremes of other bricks than those written are bounds.

    Parameters
    ----------
    has_checksum : not in stores of version 1
    """
    most = WHOLE_FILE_BYTES + 64 * (math.prod(layout.counts_zyx) + math.prod(block_counts(layout.shape_zyx)))
    data, _ = read_range(path, most=most)
    with guard(DataError, path), np.load(BytesIO(data), allow_pickle=False) as archive:
        found = {key: archive[key] for key in archive.files}
        if has_checksum and _checksum(found) != found.get("checksum", -1):
            raise DataError("statistics have a wrong checksum: damaged", where=str(path))
        side, margin = found["layout"].tolist()
        written = BrickLayout(layout.shape_zyx, side, margin)
        shapes = found["minimum"].shape, found["maximum"].shape, found["blocks"].shape
        if shapes != (written.counts_zyx, written.counts_zyx, (2, *block_counts(layout.shape_zyx))):
            raise DataError("statistics of another volume", where=str(path), found=shapes[0])
        known = {key: found[f"category_{key}"] for key in Categories.__annotations__ if f"category_{key}" in found}
        low, high = found["value_range"].tolist()
        return VolumeSummary(
            _combined(np.minimum, found["minimum"], written, layout),
            _combined(np.maximum, found["maximum"], written, layout),
            found["histogram"],
            (low, high),
            tuple((q, value) for q, value in found["percentiles"].tolist()),
            found["blocks"],
            Categories(**known | {key: int(known[key]) for key in ("pairs", "jumps")}) if known else None,
        )


def _arrays(values: Any) -> dict[str, Any]:
    return {key: value for key, value in vars(values).items() if key != "categories"}


def _checksum(arrays: Mapping[str, Any]) -> int:
    parts = []
    for name, values in sorted((name, np.asarray(each)) for name, each in arrays.items() if name != "checksum"):
        parts += [f"{name} {values.dtype.str} {values.shape} ".encode(), values.tobytes()]
    return int.from_bytes(checksum(b"".join(parts)), "little")


def _combined(pick: np.ufunc, values: NDArray[Any], written: BrickLayout, layout: BrickLayout) -> NDArray[Any]:
    """Return the extremes of the bricks of a layout: of those bricks written that cover their samples along each axis.

    Written bricks lie `written.brick` cells apart and overlap, so the last one that begins before the samples, and the
    first one that ends after them, cover them together with those between. They are one brick if the layouts are equal.
    """
    for axis, count in enumerate(layout.counts_zyx):
        spans, last = [], values.shape[axis] - 1
        for i in range(count):
            z, y, x = (i if other == axis else 0 for other in range(3))
            begin, end = (corner[axis] for corner in layout.sample_box((z, y, x)))
            first = min(last, (begin + written.margin) // written.brick)
            final = min(last, -(-(end - 1 - written.margin) // written.brick) - 1)
            spans.append(range(first, max(first, final) + 1))
        values = np.stack([pick.reduce(values.take(span, axis), axis) for span in spans], axis)
    return values
