"""Source whose samples lie at constant strides in byte storage, as in most formats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab
from clusterviz.data.header import check_box, check_dtype
from clusterviz.data.source import Grid, Index
from clusterviz.data.storage import Storage

MAX_READ_GAP = 4096  # bytes between two rows that are read rather than skipped by a second request


@dataclass(frozen=True)
class StridedSource:
    """Samples at constant strides.

    Attributes
    ----------
    storage : of the bytes
    stored_dtype : dtype in the file, with its byte order
    offset : bytes before the first sample
    strides : bytes from one sample to the next along z, y, x; by default contiguous, x fastest
    scale : (slope, intercept) applied to every sample, or None
    slab : the volume's part of an array with more axes, or None
    """

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    storage: Storage
    stored_dtype: np.dtype[Any]
    offset: int = 0
    strides: Index | None = None
    scale: tuple[float, float] | None = None
    slab: Hyperslab | None = None

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of a box, plane by plane in the order of the file; see `Source.read`."""
        box = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        _, y, x = self.grid.shape_zyx
        item = self.stored_dtype.itemsize
        strides = self.strides or (y * x * item, x * item, item)
        axes = sorted(range(3), key=lambda axis: -strides[axis])  # slowest first
        slow_bytes, row_bytes, sample_bytes = (strides[axis] for axis in axes)
        stored = np.empty([box[axis] for axis in axes], self.stored_dtype)
        if stored.size:
            begin = self.offset + sum(b * stride for b, stride in zip(begin_zyx, strides, strict=True))
            for i, plane in enumerate(stored):
                self._read_plane(begin + i * slow_bytes, row_bytes, sample_bytes, plane)
        return self._finish(stored.transpose(np.argsort(axes)))

    def _read_plane(self, begin: int, row_bytes: int, sample_bytes: int, plane: NDArray[Any]) -> None:
        """Fill `plane` (rows, columns) with the samples from byte `begin`."""
        rows, columns = plane.shape
        line_bytes = (columns - 1) * sample_bytes + self.stored_dtype.itemsize
        if rows > 1 and row_bytes - line_bytes > MAX_READ_GAP:
            for i, row in enumerate(plane):
                line = self.storage.read_at(begin + i * row_bytes, line_bytes)
                row[:] = np.ndarray(columns, self.stored_dtype, line, strides=(sample_bytes,))
            return
        span = self.storage.read_at(begin, (rows - 1) * row_bytes + line_bytes)
        plane[:] = np.ndarray(plane.shape, self.stored_dtype, span, strides=(row_bytes, sample_bytes))

    def _finish(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Convert to native byte order, C order and scaled values."""
        if self.scale is not None:
            slope, intercept = self.scale
            return np.ascontiguousarray(stored * np.float64(slope) + np.float64(intercept), self.dtype)
        return np.ascontiguousarray(stored, self.dtype)


def slab_source(
    where: str,
    slab: Hyperslab,
    grid: Grid,
    storage: Storage,
    stored: np.dtype[Any],
    begin: int = 0,
    fortran: bool = False,
) -> StridedSource:
    """Return the volume in an array that begins with byte `begin` of a storage."""
    dtype, (offset, strides) = check_dtype(stored, where), slab.strides(stored.itemsize, fortran)
    return StridedSource(where + slab.label, grid, dtype, storage, stored, begin + offset, strides, slab=slab)
