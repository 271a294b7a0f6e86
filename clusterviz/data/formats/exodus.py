"""Exodus II (.exo, .e, .ex2, .g): element blocks, and variables of one time step; the netCDF4 package reads the file.

Blocks of particles, beams and shells are left out. Variables of elements that a block lacks are NaN there.

References
----------
L. A. Schoof, V. R. Yarberry: EXODUS II: a finite element data model, SAND92-2137, 1994, appendix A, figures 4 to 9
(the order of nodes).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.classic_netcdf import read_classic
from clusterviz.data.files import library, start_of
from clusterviz.data.grid_files import choose_step
from clusterviz.data.unstructured import CORNERS, UnstructuredGrid, linearised
from clusterviz.errors import DataError

KINDS = {"TET": "tetra", "PYR": "pyramid", "WED": "wedge", "HEX": "hexahedron"}
FLAT = {"SPH": "vertex", "CIR": "vertex", "BAR": "line", "BEA": "line", "TRU": "line", "ROD": "line"}
FLAT |= {"TRI": "triangle", "SHE": "quad", "QUA": "quad", "NSI": "polygon"}
# VTK's nodes on the edges between both layers come last.
ORDERS = {
    "hexahedron20": [*range(12), *range(16, 20), *range(12, 16)],
    "hexahedron27": [*range(12), *range(16, 20), *range(12, 16), 23, 24, 25, 26, 21, 22, 20],
    "wedge15": [*range(9), *range(12, 15), *range(9, 12)],
    "wedge18": [*range(9), *range(12, 15), *range(9, 12), 15, 16, 17],
}


def read_exodus(path: Path, time: float | None = None) -> UnstructuredGrid:
    where, netcdf = str(path), library("netCDF4", "grids", str(path))
    if start_of(path)[:3] == b"CDF":
        read_classic(path)  # checks its size, since the library takes zeros for what is missing
    with netcdf.Dataset(where) as file:
        file.set_auto_mask(False)
        variables, sizes = file.variables, {name: len(size) for name, size in file.dimensions.items()}
        if sizes.get("num_dim") != 3:
            raise DataError("not three-dimensional", where=where, found=sizes.get("num_dim"), allowed=3)
        if "coord" in variables:
            points = np.ascontiguousarray(variables["coord"][:].T)
        elif "coordx" not in variables:  # a piece without nodes
            points = np.zeros((0, 3))
        else:
            points = np.stack([variables[f"coord{axis}"][:] for axis in "xyz"], axis=1)
        step = _step(variables, time, where)
        of_points = {
            name: array
            for number, name in enumerate(_names(variables, "name_nod_var"), 1)
            if (array := _values(variables, f"vals_nod_var{number}", "vals_nod_var", number - 1, step)) is not None
        }
        blocks, parts = list[tuple[str, NDArray[Any]]](), list[dict[str, NDArray[Any]]]()
        names = _names(variables, "name_elem_var")
        for block in range(1, sizes.get("num_el_blk", 0) + 1):
            if f"connect{block}" not in variables:
                continue  # an empty block
            connect = variables[f"connect{block}"]
            corners = connect[:].astype(np.int64) - 1
            kind = _kind(str(getattr(connect, "elem_type", "")), corners.shape[1], where)
            blocks.append((kind, corners[:, ORDERS[kind]] if kind in ORDERS else corners))
            missing = np.full(len(corners), np.nan)
            found = (variables.get(f"vals_elem_var{number}eb{block}") for number in range(1, len(names) + 1))
            parts.append({n: missing if v is None else v[step] for n, v in zip(names, found, strict=True)})
    of_cells = {name: np.concatenate([part[name] for part in parts]) for name in names if parts}
    return linearised(points, blocks, of_points, of_cells, where)


def _kind(stated: str, nodes: int, where: str) -> str:
    key = stated.strip().upper()[:3]
    if key in FLAT:
        return FLAT[key]
    if key not in KINDS:
        allowed = ", ".join([*KINDS, *FLAT])
        raise DataError("elements of an unsupported kind", where=where, found=stated, allowed=allowed)
    return KINDS[key] if nodes == CORNERS[KINDS[key]] else f"{KINDS[key]}{nodes}"


def _names(variables: Any, key: str) -> list[str]:
    if key not in variables:
        return []
    return [b"".join(row.tolist()).split(b"\0")[0].decode("utf-8", "replace").strip() for row in variables[key][:]]


def _values(variables: Any, key: str, old: str, row: int, step: int) -> NDArray[Any] | None:
    """Return a variable of the nodes at a step; older files have all of them in one."""
    if key in variables:
        return np.asarray(variables[key][step])
    return np.asarray(variables[old][step, row]) if old in variables else None


def _step(variables: Any, time: float | None, where: str) -> int:
    times = np.asarray(variables["time_whole"][:]) if "time_whole" in variables else np.zeros(0)
    return choose_step(times, time, where)
