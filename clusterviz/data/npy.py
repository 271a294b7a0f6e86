"""NumPy's own files (.npy): a short header, then the array; C or Fortran order, any byte order.

They know no spacing: samples lie 1 apart, the first at the origin. For others, put the array into a raw file with a
sidecar, or wrap it in an `ArraySource` with a grid.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clusterviz.data.files import readable, refuse_array, require_file
from clusterviz.data.grid import Grid
from clusterviz.data.header import check_dtype, check_shape, check_size
from clusterviz.data.linear import LinearSource
from clusterviz.data.storage import FileBytes, Piece
from clusterviz.errors import DataError


def open_npy(path: Path, array: str | None = None) -> LinearSource:
    """A (z, y, x) or (y, x) array in a .npy file.

    Raises
    ------
    DataError
        Not a .npy file, truncated or longer than its header says, or not a scalar volume.
    """
    size = require_file(path, (b"\x93NUMPY",))
    refuse_array(array, path)
    where = str(path)
    with readable(path), path.open("rb") as file:
        try:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, fortran, stored = read(file)
        except ValueError as error:
            raise DataError(f"the header cannot be read: {error}", where=where) from error
        begin = file.tell()
    dtype = check_dtype(stored, where)
    shape_zyx = check_shape(shape, where)
    needed = int(np.prod(shape_zyx, dtype=object)) * stored.itemsize
    check_size(size - begin, needed, where, exact=True)
    file_axes = (0, 1, 2)
    if fortran:
        file_axes = (2, 1, 0)
    storage = FileBytes([Piece(path, begin, needed)])
    return LinearSource(where, Grid(shape_zyx), dtype, storage, stored, file_axes=file_axes)
