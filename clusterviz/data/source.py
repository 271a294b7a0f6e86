"""Contract of a volume's data: a grid, and reading of any box of samples.

Each format is one file with `open_<format>(path, ...) -> Source`. Opening reads only the header, checks it against the
file (size, magic, dtype) and raises `DataError`. `read` reads only the bytes of its box if the format allows that.
Compressed data is streamed, so boxes in order of increasing z cost one pass over the file.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.grid import Grid

Index = tuple[int, int, int]


class Source(Protocol):
    """Volume on disk or in memory.

    Attributes
    ----------
    name : for messages: the path as given, with the array's name if there are several
    grid : positions of the samples
    dtype : of the samples, native byte order: any NumPy integer or float type
    """

    @property
    def name(self) -> str: ...

    @property
    def grid(self) -> Grid: ...

    @property
    def dtype(self) -> np.dtype[Any]: ...

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of the half-open box [begin, end).

        Returns
        -------
        voxels : dtype `self.dtype` (native byte order), shape end − begin, (z, y, x), C order, owned by the caller

        Raises
        ------
        DataError
            The file ends early or cannot be decoded.
        """
        ...
