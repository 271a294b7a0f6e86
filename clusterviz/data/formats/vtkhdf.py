"""VTK's unstructured grids in HDF5 (.vtkhdf): one grid without time steps, whose pieces are joined.

References
----------
VTK File Formats, "VTKHDF File Format", https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.unstructured import UnstructuredGrid
from clusterviz.data.vtk_cells import grid_of_cells
from clusterviz.errors import DataError

MOST = 1 << 36
"""Bytes of an array; a file may state more than it holds."""


def read_vtkhdf(path: Path) -> UnstructuredGrid:
    """Read a .vtkhdf file."""
    import h5py

    with h5py.File(path) as file:
        root = file.get("VTKHDF")
        kind = root.attrs.get("Type", b"") if root is not None else b"no group VTKHDF"
        kind = kind.decode("utf-8", "replace") if isinstance(kind, bytes) else str(kind)
        if kind != "UnstructuredGrid":
            raise DataError("not an unstructured grid", where=str(path), found=kind, allowed="UnstructuredGrid")
        if "Steps" in root:
            raise DataError("has time steps", where=str(path), allowed="a grid without Steps")

        def load(name: str) -> NDArray[Any]:
            return load_dataset(root[name])

        counts = {name: load(f"NumberOf{name}").astype(np.int64) for name in ("Points", "Cells", "ConnectivityIds")}
        points, types, corners = load("Points"), load("Types"), load("Connectivity").astype(np.int64)
        offsets, begins, shift = load("Offsets").astype(np.int64), [np.zeros(1, np.int64)], 0
        first = np.cumsum(counts["Cells"] + 1) - counts["Cells"] - 1
        ends = np.cumsum(counts["ConnectivityIds"])
        for piece, begin in enumerate(first.tolist()):
            begins.append(offsets[begin + 1 : begin + 1 + int(counts["Cells"][piece])] + shift)
            shift = int(ends[piece])
        if min(map(np.min, counts.values()), default=0) < 0 or ends[-1] != len(corners):
            raise DataError("the counts do not fit", where=str(path), found=f"{len(corners)} indices")
        corners += np.repeat(np.cumsum(counts["Points"]) - counts["Points"], counts["ConnectivityIds"])
        of_points, of_cells = (
            {
                name: load(f"{group}/{name}")
                for name in root.get(group, {})
                if root[f"{group}/{name}"].dtype.kind in "iuf"
            }
            for group in ("PointData", "CellData")
        )
    return grid_of_cells(points, types, np.concatenate(begins), corners, of_points, of_cells, str(path))


def load_dataset(data: Any) -> NDArray[Any]:
    """Return all of a dataset of HDF5, whose header may lie about its size."""
    stored = data.id.get_storage_size()
    if data.size * data.dtype.itemsize > min(MOST, 1100 * max(stored, 1)):  # deflate's most
        where, found = f"{data.file.filename}:{data.name}", f"{data.shape} in {stored} bytes"
        raise DataError("truncated, or its header lies", where=where, found=found)
    return np.asarray(data[()])
