"""CGNS (.cgns) in HDF5: unstructured zones, their element sections, and solutions at vertices and in cells.

Zones are joined. Of several solutions at one place the last one counts, which is the last time step of most programs.

References
----------
CGNS Standard Interface Data Structures, "Grid Coordinates, Elements, and Flow Solutions" and "Element Numbering";
CGNS/HDF5 file mapping, https://cgns.github.io
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from clusterviz.data.formats.exodus import ORDERS
from clusterviz.data.formats.vtkhdf import load_dataset
from clusterviz.data.unstructured import UnstructuredGrid, joined_grids, linearised, nodes_of
from clusterviz.errors import DataError

_FIRST = """vertex line line3 triangle triangle6 quad quad8 quad9 tetra tetra10 pyramid pyramid14 wedge wedge15 wedge18
hexahedron hexahedron20 hexahedron27"""
KINDS = dict(enumerate(_FIRST.split(), 2)) | {21: "pyramid13"}
MIXED, POLYGONS, POLYHEDRA = 20, 22, 23
"""Numbers of ElementType_t; in sections of mixed elements each has its number in front."""
NODES = {**ORDERS, "hexahedron27": [*range(12), *range(16, 20), *range(12, 16), 24, 22, 21, 23, 20, 25, 26]}
"""Of kinds whose order is not VTK's, the places of VTK's nodes."""


def read_cgns(path: Path) -> UnstructuredGrid:
    with h5py.File(path) as file:
        zones = [zone for base in _children(file, "CGNSBase_t") for zone in _children(base, "Zone_t")]
        grids = [_zone(zone, str(path)) for zone in zones if list(_children(zone, "Elements_t"))]
    if not grids:
        allowed = "CGNS in HDF5 with an unstructured zone"
        raise DataError("no elements", where=str(path), found=f"{len(zones)} zones", allowed=allowed)
    return grids[0] if len(grids) == 1 else joined_grids(grids, str(path))


def _children(node: Any, label: str) -> Iterator[Any]:
    for child in node.values():
        found = child.attrs.get("label", b"")
        if (found.decode() if isinstance(found, bytes) else str(found)) == label:
            yield child


def _name(node: Any) -> str:
    return str(node.name.rpartition("/")[2])


def _data(node: Any) -> NDArray[Any]:
    return load_dataset(node[" data"]).reshape(-1)


def _zone(zone: Any, where: str) -> UnstructuredGrid:
    coordinates = {_name(one): one for one in _children(next(_children(zone, "GridCoordinates_t")), "DataArray_t")}
    points = np.stack([_data(coordinates[f"Coordinate{axis}"]) for axis in "XYZ"], axis=1)
    sections = sorted(_children(zone, "Elements_t"), key=lambda section: int(_data(section["ElementRange"])[0]))
    blocks = [block for section in sections for block in _blocks(section, f"{where}:{_name(section)}")]
    of: dict[str, dict[str, NDArray[Any]]] = {"Vertex": {}, "CellCenter": {}}
    for solution in _children(zone, "FlowSolution_t"):
        location = next(
            (bytes(_data(one).astype(np.uint8)).decode() for one in _children(solution, "GridLocation_t")), ""
        )
        arrays = {_name(one): _data(one) for one in _children(solution, "DataArray_t")}
        of.get(location or "Vertex", {}).update(
            (name, each) for name, each in arrays.items() if each.dtype.kind in "iuf"
        )
    # Solutions in cells are those of elements with a volume, or of all.
    flat = [np.full(len(corners), kind.startswith(("vertex", "line", "triangle", "quad"))) for kind, corners in blocks]
    is_flat = np.concatenate([np.zeros(0, bool), *flat])
    of_cells = dict[str, NDArray[Any]]()
    for name, array in of["CellCenter"].items():
        of_cells[name] = array
        if len(array) == np.count_nonzero(~is_flat):
            of_cells[name] = np.zeros(len(is_flat), array.dtype)
            of_cells[name][~is_flat] = array
    return linearised(points, blocks, of["Vertex"], of_cells, where)


def _blocks(section: Any, where: str) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Yield the elements of a section; each run of one kind in a section of mixed ones is a block."""
    kind, (first, last) = int(_data(section)[0]), _data(section["ElementRange"])[:2].tolist()
    corners, count = _data(section["ElementConnectivity"]).astype(np.int64), last - first + 1
    if kind == MIXED:
        if "ElementStartOffset" not in section:
            raise DataError("mixed elements without ElementStartOffset", where=where, allowed="CGNS 4.0 or later")
        begins = _data(section["ElementStartOffset"]).astype(np.int64)[:count]
        kinds = corners[begins]
        ends = np.append(np.flatnonzero(np.diff(kinds)) + 1, count)
        for begin, end in zip(np.append(0, ends[:-1]).tolist(), ends.tolist(), strict=True):
            name = _kind(int(kinds[begin]), where)
            yield _ordered(name, corners[begins[begin:end, None] + 1 + np.arange(nodes_of(name))])
        return
    name = _kind(kind, where)
    nodes = nodes_of(name)
    if len(corners) != count * nodes:
        found, allowed = f"{len(corners)} indices", f"{count} x {nodes} of {name}"
        raise DataError("the connectivity does not fit", where=where, found=found, allowed=allowed)
    yield _ordered(name, corners.reshape(count, nodes))


def _ordered(kind: str, corners: NDArray[np.int64]) -> tuple[str, NDArray[np.int64]]:
    return kind, corners[:, NODES.get(kind, slice(None))] - 1


def _kind(number: int, where: str) -> str:
    if number not in KINDS:
        found = "polygons and polyhedra" if number in (POLYGONS, POLYHEDRA) else f"ElementType_t {number}"
        allowed = ", ".join(dict.fromkeys(KINDS.values()))
        raise DataError("elements of an unsupported kind", where=where, found=found, allowed=allowed)
    return KINDS[number]
