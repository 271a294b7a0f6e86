"""Statistics that a store keeps: the summary of its finest level, with which a volume is opened without reading it.

OUT.ome.zarr/bricks/statistics.npz   the arrays of a `VolumeSummary`, and their checksum, as of numpy.savez_compressed
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import BrickLayout
from clusterviz.data.remote import WHOLE_FILE_BYTES, FilePath, read_range
from clusterviz.data.store.shards import checksum
from clusterviz.data.summary import Categories, VolumeSummary, block_counts
from clusterviz.errors import DataError, guard
from clusterviz.image.replace import replacing

MARGIN = 2
"""Samples beyond the corners of a brick's cells that its extremes include; as many as most blend modes need."""


def write_statistics(path: Path, summary: VolumeSummary, layout: BrickLayout) -> None:
    """Write the summary of a volume with bricks of one size."""
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
