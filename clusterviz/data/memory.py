"""NumPy array as a source, for `clusterviz.render(array)` and tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.header import check_box, check_dtype, check_shape
from clusterviz.data.source import Grid, Index
from clusterviz.errors import DataError


class ArraySource:
    """Volume in a NumPy array, which is copied only when a box is read.

    Parameters
    ----------
    array : any integer, boolean or float dtype, (z, y, x) or (y, x)
    grid : positions of the samples; by default 1 apart from the world's origin

    Raises
    ------
    DataError
        Not a scalar volume, or a grid of another shape.
    """

    def __init__(self, array: NDArray[Any], grid: Grid | None = None, name: str = "array") -> None:
        shape_zyx = check_shape(array.shape, name)
        if grid is not None and grid.shape_zyx != shape_zyx:
            raise DataError("the grid does not fit the array", where=name, found=grid.shape_zyx, allowed=shape_zyx)
        self._array, self.grid, self.name = array.reshape(shape_zyx), grid or Grid(shape_zyx), name
        self.dtype = check_dtype(array.dtype, name)

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        (z, y, x), (z_end, y_end, x_end) = begin_zyx, end_zyx
        return np.array(self._array[z:z_end, y:y_end, x:x_end], self.dtype, order="C", copy=True)
