"""VTK image files in XML (.vti), as ParaView, PyVista and many simulations write them; see `clusterviz.data.vtk_xml`.

Point data lies on the samples; cell data is point data at the cells' centres. Without a name the active scalars are
taken, or the only scalar array.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Subset, select
from clusterviz.data.files import require_file
from clusterviz.data.header import check_dtype
from clusterviz.data.source import Grid
from clusterviz.data.strided import StridedSource
from clusterviz.data.vtk_image import choose_array, image_grid
from clusterviz.data.vtk_xml import XmlLayout, scan_xml, storage_of, stored_dtype
from clusterviz.errors import DataError


def open_vti(path: Path, subset: Subset) -> StridedSource:
    """Open one scalar array of a VTK image file.

    Raises
    ------
    DataError
        Not such a file, damaged or truncated, several pieces, no such array, several and none named, or vectors.
    """
    size = require_file(path)
    layout = scan_xml(path, "ImageData")
    scalars = [a for a in layout.arrays if a.components == 1]
    chosen = choose_array(scalars, subset.array, "scalar array", path)
    where = f"{path}:{chosen.name}" if len(layout.arrays) > 1 else str(path)
    stored = stored_dtype(layout, chosen, where)
    grid = _grid_of(layout, chosen.on_cells, path)
    select(grid.shape_zyx, "ZYX", subset, where)
    count = int(np.prod(grid.shape_zyx, dtype=object))
    storage, offset = storage_of(path, size, layout, chosen, stored, count, where)
    return StridedSource(where, grid, check_dtype(stored, where), storage, stored, offset)


def _grid_of(layout: XmlLayout, on_cells: bool, path: Path) -> Grid:
    """Return the grid of the samples; the origin belongs to index 0, and the extent may begin elsewhere."""
    where, image = str(path), layout.dataset
    if len(layout.pieces) != 1:
        raise DataError("unsupported", where=where, found=f"{len(layout.pieces)} pieces", allowed="one piece")
    extent = _numbers(layout.pieces[0], "Extent", image.get("WholeExtent", ""), 6, where).reshape(3, 2)
    if "WholeExtent" in image and (extent != _numbers(image, "WholeExtent", "", 6, where).reshape(3, 2)).any():
        raise DataError(
            "unsupported: the piece is not the whole", where=where, found=extent.tolist(), allowed=image["WholeExtent"]
        )
    points = extent[:, 1] - extent[:, 0] + 1
    spacing = _numbers(image, "Spacing", "1 1 1", 3, where)
    steps = _numbers(image, "Direction", "1 0 0 0 1 0 0 0 1", 9, where).reshape(3, 3) * spacing
    origin = _numbers(image, "Origin", "0 0 0", 3, where)
    return image_grid(points, steps, origin, extent[:, 0], on_cells, where)


def _numbers(attributes: Mapping[str, str], key: str, default: str, count: int, where: str) -> NDArray[np.float64]:
    text = attributes.get(key, default)
    try:
        numbers = np.array(text.split(), float)
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise DataError(f"impossible {key}", where=where, found=repr(text), allowed=f"{count} numbers")
    return numbers
