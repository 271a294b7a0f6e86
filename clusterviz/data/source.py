"""The contract of every data format: a source knows its grid and reads any box of samples.

One file a format; each offers `open_<format>(path, ...) -> Source`. Opening reads the header only, checks it against
the file (size, magic, dtype) and raises `DataError` with what, where, found and allowed. Reading is lazy: `read`
touches the bytes of its box where the format allows that, and streams forward through the file where it does not
(compressed data), so that asking for boxes in order of increasing z costs one pass over the file.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid

Index = tuple[int, int, int]


class Source(Protocol):
    """A volume on disk or in memory.

    Attributes
    ----------
    name : what messages call it: the path as given, with the array's name where there are several
    grid : where the samples lie
    dtype : dtype of the samples, native byte order: any NumPy integer or float type
    """

    @property
    def name(self) -> str: ...

    @property
    def grid(self) -> Grid: ...

    @property
    def dtype(self) -> np.dtype[Any]: ...

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """The samples of the half-open box [begin, end).

        Returns
        -------
        voxels : dtype `self.dtype` (native byte order), shape end − begin, (z, y, x), C order, owned by the caller

        Raises
        ------
        DataError
            The file ends early or cannot be decoded.
        """
        ...
