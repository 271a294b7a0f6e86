"""Boxes out of an array that lies in one piece: the source behind most formats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid
from clusterviz.data.header import check_box
from clusterviz.data.source import Index
from clusterviz.data.storage import Storage

WORTH_READING = 4096  # bytes between two rows that cost less to read than a second request does


@dataclass(frozen=True)
class LinearSource:
    """Samples stored one after another.

    Attributes
    ----------
    name, grid, dtype : as in `Source`
    storage : where the bytes are
    stored_dtype : dtype in the file, with its byte order
    offset : bytes before the first sample
    file_axes : which of (z, y, x) = (0, 1, 2) the slowest, middle and fastest axis of the file is
    scale : (slope, intercept) applied to every sample, or None
    """

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    storage: Storage
    stored_dtype: np.dtype[Any]
    offset: int = 0
    file_axes: Index = (0, 1, 2)
    scale: tuple[float, float] | None = None

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """The samples of the box, plane by plane in the order of the file; see `Source.read`."""
        box = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        stored = np.empty([box[a] for a in self.file_axes], self.stored_dtype)
        if stored.size:
            begin = [begin_zyx[a] for a in self.file_axes]
            for i, plane in enumerate(stored):
                self._read_plane(begin[0] + i, begin[1], begin[2], plane)
        return self._finish(stored.transpose(np.argsort(self.file_axes)))

    def _read_plane(self, slow: int, middle: int, fast: int, plane: NDArray[Any]) -> None:
        """Fill `plane` (rows, columns) with the samples from (slow, middle, fast) on."""
        _, row_count, row_length = (self.grid.shape_zyx[a] for a in self.file_axes)
        item = self.stored_dtype.itemsize
        row_bytes = row_length * item
        begin = self.offset + ((slow * row_count + middle) * row_length + fast) * item
        rows, columns = plane.shape
        if rows > 1 and row_bytes - columns * item > WORTH_READING:
            for i in range(rows):
                line = self.storage.read_at(begin + i * row_bytes, columns * item)
                plane[i] = np.frombuffer(line, self.stored_dtype)
            return
        span = self.storage.read_at(begin, (rows - 1) * row_bytes + columns * item)
        plane[:] = np.ndarray(plane.shape, self.stored_dtype, span, strides=(row_bytes, item))

    def _finish(self, stored: NDArray[Any]) -> NDArray[Any]:
        """To native byte order, C order and real values."""
        if self.scale is not None:
            slope, intercept = self.scale
            return np.ascontiguousarray(stored * np.float64(slope) + np.float64(intercept), self.dtype)
        return np.ascontiguousarray(stored, self.dtype)
