"""NumPy files (.npy), in C or Fortran order and any byte order.

Four axes are (time, z, y, x), or (channel, z, y, x) if a channel is named; five are (time, channel, z, y, x). The file
has no spacing: samples lie 1 apart, the first at the origin, unless the scene sets the grid.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.data.axes import Subset, select, unnamed_axes
from clusterviz.data.files import readable, refuse_array, require_file
from clusterviz.data.grid import Grid
from clusterviz.data.header import check_dtype, check_size
from clusterviz.data.storage import FileBytes, FileRange
from clusterviz.data.strided import StridedSource
from clusterviz.errors import DataError


def open_npy(path: Path, subset: Subset) -> StridedSource:
    """Open an array of two to five axes in a .npy file.

    Raises
    ------
    DataError
        Not a .npy file, truncated or longer than its header says, or not a scalar volume.
    """
    size = require_file(path)
    refuse_array(subset.array, path)
    where = str(path)
    with readable(path), path.open("rb") as file:
        shape, fortran, stored = read_header(file, where)
        begin = file.tell()
    dtype = check_dtype(stored, where)
    slab = select(shape, unnamed_axes(len(shape), subset), subset, where)
    needed = slab.samples * stored.itemsize
    check_size(size - begin, needed, where, exact=True)
    storage = FileBytes([FileRange(path, begin, needed)])
    offset, strides = slab.strides(stored.itemsize, fortran)
    return StridedSource(where + slab.label, Grid(slab.shape_zyx), dtype, storage, stored, offset, strides, slab=slab)


def read_header(file: Any, where: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read shape, whether in Fortran order, and stored dtype from the start of a .npy file."""
    try:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, stored = read(file)
    except ValueError as error:
        raise DataError(f"the header cannot be read: {error}", where=where) from error
    return shape, fortran, stored
