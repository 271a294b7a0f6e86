"""Pictures (.png, .jpg, .bmp, .pgm, …) as one layer, by Pillow; mostly slices of a folder.

The samples are grey values or palette indices; of colours, `channel` is one. Pillow reduces 16-bit colours to 8 bits,
but not 16-bit grey.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, select
from clusterviz.data.files import refuse_array, require_file
from clusterviz.data.grid import Grid
from clusterviz.data.header import check_box, check_packed
from clusterviz.data.source import Index
from clusterviz.errors import DataError

NAMES = {"R": "red", "G": "green", "B": "blue", "A": "alpha", "L": "grey"}
TYPES = {"1": "u1", "I;16": "u2", "I;16L": "u2", "I;16B": "u2", "I;16N": "u2", "I": "i4", "F": "f4"}


@dataclass(frozen=True)
class PictureSource:
    """Picture that is decoded when it is read."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    path: Path
    slab: Hyperslab

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        """Read the samples of a box; see `Source.read`."""
        from PIL import Image

        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        if 0 in shape:
            return np.empty(shape, self.dtype)
        try:
            with Image.open(self.path) as image:
                pixels = np.asarray(image).reshape(self.slab.shape)
        except Exception as error:  # decoders raise many kinds
            raise DataError(f"the picture cannot be decoded: {error}", where=self.name) from error
        (_, y, x), (_, y_end, x_end) = begin_zyx, end_zyx
        return np.array(pixels[y:y_end, x:x_end, self.slab.channel], self.dtype, order="C").reshape(shape)


def open_picture(path: Path, subset: Subset) -> PictureSource:
    """Open a picture as one layer.

    Raises
    ------
    DataError
        Not a picture, truncated, or several channels and none named.
    """
    from PIL import Image

    size = require_file(path)
    refuse_array(subset.array, path)
    try:
        with Image.open(path) as image:
            mode, bands, (width, height) = image.mode, image.getbands(), image.size
    except Exception as error:  # each decoder has its own kind
        raise DataError(f"wrong magic or damaged: {error}", where=str(path)) from error
    dtype = np.dtype(TYPES.get(mode, "u1"))
    slab = select((height, width, len(bands)), "YXC", subset, str(path), [NAMES.get(band, band) for band in bands])
    check_packed(size, slab.samples * dtype.itemsize, "TIFF", str(path))
    return PictureSource(f"{path}{slab.label}", Grid(slab.shape_zyx), dtype, path, slab)
