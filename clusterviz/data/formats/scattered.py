"""Files of points as volumes: any file of meshes, lines, points or an unstructured grid, by its vertices or points.

The key `scattered` of a volume asks for it. `array` names the values; a file with a single array of one number for each
point needs no name.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data import grid_format_of, read_geometry, read_grid
from clusterviz.data.axes import Subset
from clusterviz.data.scattered import ScatteredSource, scattered
from clusterviz.errors import DataError


def open_scattered(path: Path, subset: Subset) -> ScatteredSource:
    """Open a file of points; it is read whole."""
    assert subset.scattered is not None
    positions, arrays = _points(path)
    numbers = {name: array.reshape(-1) for name, array in arrays.items() if array.size == len(array)}
    numbers = {name: array for name, array in numbers.items() if array.dtype.kind in "iufb"}
    listed = ", ".join(numbers) or "none: the file has no array with one number a point"
    name = subset.array or (next(iter(numbers)) if len(numbers) == 1 else "")
    if name not in numbers:
        what = "no such array" if subset.array or not numbers else "several arrays: name one"
        raise DataError(what, where=str(path), found=subset.array, allowed=listed)
    where = f"{path}:{name}" if len(numbers) > 1 else str(path)
    return scattered(positions, numbers[name], subset.scattered.size, subset.scattered.bounds, where)


def _points(path: Path) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
    """Return positions, (n, 3), and the arrays that belong to them."""
    if grid_format_of(path):
        grid = read_grid(path)
        return grid.points, dict(grid.point_arrays)
    geometry = read_geometry(path)
    parts = [(part.positions, part.attributes) for part in (geometry.points,) if part]
    parts += [(part.points, part.point_attributes) for part in (geometry.lines,) if part]
    parts += [(part.vertices, part.vertex_attributes) for part in (geometry.mesh,) if part]
    positions, arrays = max(parts, key=lambda part: len(part[0]), default=(np.empty((0, 3)), {}))
    return positions, dict(arrays)
