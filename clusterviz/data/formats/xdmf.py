"""XDMF (.xdmf, .xmf), versions 2 and 3: unstructured grids, alone and in collections of time steps and of pieces.

Numbers are text in the file, datasets of HDF5 or raw files. Of a collection of time steps one is read, and where there
are several, the last step of each up to it. Grids of one mesh, as programs write them for each of their functions, are
one grid with the arrays of all; others are pieces, which are joined. Arrays of faces, of edges and of whole grids, and
finite-element functions, which need their program's shape functions, are ignored, with a warning.

References
----------
XDMF model and format, https://www.xdmf.org/index.php/XDMF_Model_and_Format; XInclude 1.0, as FEniCS uses it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import explained, read_xml, readable, require_file
from clusterviz.data.formats.vtkhdf import load_dataset
from clusterviz.data.grid_files import choose_step
from clusterviz.data.header import check_size
from clusterviz.data.storage import numbers_from_text
from clusterviz.data.unstructured import UnstructuredGrid, joined_grids, linearised, nodes_of
from clusterviz.errors import DataError, warn_of_data

Element = ElementTree.Element
Block = tuple[str, NDArray[np.int64]]
WORDS = {"polyvertex": "vertex", "polyline": "line", "polygon": "polygon", "edge": "line", "triangle": "triangle"}
WORDS |= {"tri": "triangle", "quadrilateral": "quad", "quad": "quad", "tetrahedron": "tetra", "tet": "tetra"}
WORDS |= {"pyramid": "pyramid", "wedge": "wedge", "hexahedron": "hexahedron", "hex": "hexahedron"}
"""meshio's names of kinds of cells, before the number of nodes."""
NUMBERS = {1: "vertex", 2: "line", 3: "polygon", 4: "triangle", 5: "quad", 6: "tetra", 7: "pyramid", 8: "wedge"}
NUMBERS |= {9: "hexahedron", 0x22: "line3", 0x23: "quad9", 0x24: "triangle6", 0x25: "quad8", 0x26: "tetra10"}
NUMBERS |= {0x27: "pyramid13", 0x28: "wedge15", 0x29: "wedge18", 0x30: "hexahedron20", 0x32: "hexahedron27"}
"""Kinds in mixed topologies; of the first three the number of nodes follows."""
TYPES = {"float": "f", "int": "i", "uint": "u", "char": "i", "uchar": "u", "short": "i"}
GEOMETRIES = {"xyz": 3, "xy": 2, "x_y_z": 3, "x_y": 2}
"""Coordinates of points."""


def read_xdmf(path: Path, time: float | None = None) -> UnstructuredGrid:
    where = str(path)
    root = read_xml(path, "XDMF")
    file, domain = _File(path, root), root.find("Domain")
    if _tag(root) != "Xdmf" or domain is None:
        raise DataError("not XDMF", where=where, found=f"<{_tag(root)}>", allowed="<Xdmf><Domain>…")
    grids = [grid for grid in domain if _tag(grid) == "Grid"]
    times = np.array(sorted({one for grid in grids for one in file.times(grid)}))
    chosen = float(times[choose_step(times, time, where)]) if len(times) or time is not None else 0.0
    meshes: dict[object, _Mesh] = {}
    for leaf in (leaf for grid in grids for leaf in file.leaves(grid, chosen)):
        file.add(leaf, meshes)
    if not meshes:
        raise DataError("no grid", where=where, allowed="<Grid> with Topology and Geometry")
    if file.unread:
        warn_of_data("not read", where=where, found=", ".join(dict.fromkeys(file.unread)))
    pieces = [linearised(each.points, each.blocks, each.of_points, each.of_cells, where) for each in meshes.values()]
    return pieces[0] if len(pieces) == 1 else joined_grids(pieces, where)


@dataclass(frozen=True)
class _Mesh:
    """Points and cells, and the arrays of all grids that have them."""

    points: NDArray[Any]
    blocks: list[Block]
    of_points: dict[str, NDArray[Any]] = field(default_factory=dict)
    of_cells: dict[str, NDArray[Any]] = field(default_factory=dict)


def _tag(element: Element) -> str:
    return element.tag.rpartition("}")[2]


def _kind(grid: Element) -> str:
    kind = grid.get("GridType", "Uniform").lower()
    return grid.get("CollectionType", "Spatial").lower() if kind == "collection" else kind


@dataclass(frozen=True)
class _File:
    """Parsed file."""

    path: Path
    root: Element
    unread: list[str] = field(default_factory=list)

    @property
    def where(self) -> str:
        return str(self.path)

    def times(self, grid: Element) -> Iterator[float]:
        if _kind(grid) == "temporal":
            yield from self._own_times(grid)
        elif _kind(grid) in ("spatial", "tree"):
            for child in grid.findall("Grid"):
                yield from self.times(child)

    def _own_times(self, collection: Element) -> list[float]:
        """Return the time of each grid of a collection of time steps; without any, their numbers."""
        children, found = collection.findall("Grid"), collection.find("Time")
        if found is not None and (item := found.find("DataItem")) is not None:
            listed = self.numbers(item).astype(float).ravel().tolist()
            if found.get("TimeType", "List").lower() == "hyperslab" and len(listed) == 3:
                listed = [listed[0] + listed[1] * n for n in range(len(children))]
            return (listed + [float(n) for n in range(len(listed), len(children))])[: len(children)]
        own = [child.find("Time") for child in children]
        with explained("an impossible time", self.where, ValueError, allowed="<Time Value=…>"):
            return [float(n if one is None else one.get("Value", "")) for n, one in enumerate(own)]

    def leaves(self, grid: Element, time: float) -> Iterator[Element]:
        kind, children = _kind(grid), grid.findall("Grid")
        if kind == "uniform":
            yield grid
        elif kind == "temporal" and children:
            times = np.array(self._own_times(grid))
            before = np.where(times <= time, times, -np.inf)
            chosen = before.argmax() if (times <= time).any() else times.argmin()
            yield from self.leaves(children[chosen], time)
        elif kind in ("spatial", "tree"):
            for child in children:
                yield from self.leaves(child, time)
        elif children:
            allowed = "Uniform, Tree, and collections Temporal and Spatial"
            raise DataError("a grid of an unsupported type", where=self.where, found=kind, allowed=allowed)

    def add(self, grid: Element, meshes: dict[object, _Mesh]) -> None:
        parts = list(self._parts(grid))
        of = {tag: next((part for part in parts if _tag(part) == tag), None) for tag in ("Geometry", "Topology")}
        geometry, topology = of.values()
        if geometry is None or topology is None:
            found = ", ".join(map(_tag, parts))
            raise DataError("a grid without a mesh", where=self.where, found=found, allowed="Topology and Geometry")
        key = _content(geometry), _content(topology)
        if key not in meshes:
            points = self._points(geometry)
            meshes[key] = _Mesh(points, self._blocks(topology, len(points)))
        mesh = meshes[key]
        cells = sum(len(corners) for _, corners in mesh.blocks)
        of_center = {"node": (mesh.of_points, len(mesh.points)), "cell": (mesh.of_cells, cells)}
        for part in parts:
            center, name = part.get("Center", "Node"), part.get("Name", "values")
            if _tag(part) != "Attribute":
                continue
            if center.lower() not in of_center or part.get("ItemType"):
                self.unread.append(f"{part.get('ItemType', f'Center={center}')} {name}")
                continue
            arrays, count = of_center[center.lower()]
            arrays[name] = self._array(self._item(part), count, name)

    def _array(self, item: Element, count: int, name: str) -> NDArray[Any]:
        values = self.numbers(item)
        if values.size % max(count, 1) or (count and not values.size) or (values.size and not count):
            found, allowed = values.shape, f"a number or a tuple for each of {count}"
            raise DataError("an array does not fit", where=f"{self.where}: {name}", found=found, allowed=allowed)
        rows = values.reshape(count, -1) if count else values.reshape(0, 1)
        return rows[:, 0] if rows.shape[1] == 1 else rows

    def _parts(self, grid: Element) -> Iterator[Element]:
        """Yield the children of a grid, with those that it refers to in their places."""
        for child in grid:
            if _tag(child) != "include":
                yield self._resolved(child)
                continue
            pointer = re.fullmatch(r"\s*xpointer\((.*)\)\s*", child.get("xpointer", ""), re.DOTALL)
            if child.get("href") or pointer is None:
                found = f"include {child.get('href', child.get('xpointer'))}"
                raise DataError("unsupported", where=self.where, found=found, allowed="xpointer(…) into the same file")
            names = re.findall(r"self::(\w+)", pointer[1])
            target = self._find(re.sub(r"/\*\[[^\[\]]*\]$", "", pointer[1].strip()))
            yield from (part for part in self._parts(target) if _tag(part) in names) if names else [target]

    def _resolved(self, element: Element) -> Element:
        reference = element.get("Reference")
        if reference is None:
            return element
        return self._resolved(self._find((element.text or "") if reference.upper() == "XML" else reference))

    def _find(self, path: str) -> Element:
        """Return the first element at a path of XPath from the root."""
        relative = re.sub(r"^/Xdmf/", "./", path.strip())
        with explained("a path that is not understood", self.where, SyntaxError, KeyError, found=path):
            found = self.root.find(f".{relative}" if relative.startswith("//") else relative)
        if found is None:
            raise DataError("a reference to nothing", where=self.where, found=path)
        return found

    def _item(self, element: Element) -> Element:
        items = element.findall("DataItem")
        if len(items) != 1:
            found = f"{len(items)} in {_tag(element)} {element.get('Name', '')}"
            raise DataError("not one DataItem", where=self.where, found=found)
        return items[0]

    def _points(self, geometry: Element) -> NDArray[Any]:
        kind = geometry.get("GeometryType", geometry.get("Type", "XYZ"))
        width, items = GEOMETRIES.get(kind.lower(), 0), geometry.findall("DataItem")
        if not width or len(items) != (width if "_" in kind else 1):
            found, allowed = f"{kind}, {len(items)} DataItem", ", ".join(GEOMETRIES).upper()
            raise DataError("an unsupported geometry", where=self.where, found=found, allowed=allowed)
        columns = [self.numbers(item) for item in items]
        table = np.stack([each.ravel() for each in columns], 1) if len(items) > 1 else columns[0].reshape(-1, width)
        points = np.zeros((len(table), 3), np.promote_types(table.dtype, np.float32))
        points[:, :width] = table
        return points

    def _blocks(self, topology: Element, points: int) -> list[Block]:
        stated = topology.get("TopologyType", topology.get("Type", ""))
        word = re.fullmatch(r"([a-z]+)_?(\d*)", stated.lower())
        if stated.lower() == "mixed":
            blocks = _mixed(self.numbers(self._item(topology)).astype(np.int64).ravel(), self.where)
        elif word is None or word[1] not in WORDS:
            allowed = ", ".join(name.title() for name in WORDS) + ", Mixed"
            raise DataError("an unsupported topology", where=self.where, found=stated, allowed=allowed)
        elif not topology.findall("DataItem") and word[1] == "polyvertex":
            blocks = [("vertex", np.arange(points)[:, None])]
        else:
            kind, corners = WORDS[word[1]] + word[2], self.numbers(self._item(topology)).astype(np.int64)
            width = int(topology.get("NodesPerElement", "0")) or nodes_of(kind) or int(corners.shape[-1])
            blocks = [(kind, corners.reshape(-1, width))]
        base = int(topology.get("BaseOffset", "0"))
        return [(kind, corners - base) for kind, corners in blocks]

    def numbers(self, item: Element) -> NDArray[Any]:
        item = self._resolved(item)
        kind, words = item.get("ItemType", "Uniform").lower(), item.get("Dimensions", "").split()
        if not all(word.isdecimal() and len(word) < 16 for word in words):
            raise DataError("impossible Dimensions", where=self.where, found=" ".join(words))
        shape = [int(word) for word in words]
        if kind == "hyperslab":
            return self._hyperslab(item)
        if kind != "uniform":
            raise DataError("an unsupported DataItem", where=self.where, found=kind, allowed="Uniform, HyperSlab")
        form, text = item.get("Format", "XML").lower(), (item.text or "").strip()
        if form == "hdf":
            found = self._dataset(text)
        else:
            stated = item.get("NumberType", item.get("DataType", "Float")).lower()
            size = item.get("Precision", {"char": "1", "uchar": "1", "short": "2"}.get(stated, "4"))
            if stated not in TYPES or size not in ("1", "2", "4", "8") or (stated == "float" and size in "12"):
                raise DataError("an unknown type of numbers", where=self.where, found=f"{stated}, Precision={size}")
            dtype, count = np.dtype(TYPES[stated] + size), prod(shape) if shape else len(text.split())
            found = self._raw(item, text, dtype, count) if form == "binary" else self._text(text, dtype, count)
        if shape and found.size != prod(shape):
            raise DataError("an array does not fit its Dimensions", where=self.where, found=found.shape, allowed=shape)
        return found.reshape(shape) if shape else found

    def _text(self, text: str, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        return np.frombuffer(numbers_from_text(text.encode(), dtype, count, self.where), dtype)

    def _raw(self, item: Element, name: str, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        file, begin = self.path.parent / name, int(item.get("Seek", "0"))
        check_size(require_file(file), begin + count * dtype.itemsize, str(file))
        stored = dtype.newbyteorder(">") if item.get("Endian", "Native").lower() == "big" else dtype
        with readable(file):
            return np.fromfile(file, stored, count, offset=begin).astype(dtype)

    def _dataset(self, text: str) -> NDArray[Any]:
        name, _, place = text.rpartition(":")
        file = self.path.parent / name
        require_file(file, (b"\x89HDF\r\n\x1a\n",))
        with h5py.File(file) as opened:
            dataset = opened.get(place)
            if dataset is None or not hasattr(dataset, "shape") or dataset.dtype.kind not in "iufb":
                raise DataError("no such dataset of numbers", where=f"{self.where}: {name}", found=place)
            return load_dataset(dataset)

    def _hyperslab(self, item: Element) -> NDArray[Any]:
        """Return a part of an array: start, stride and count along each of its axes."""
        inner = item.findall("DataItem")
        if len(inner) != 2:
            raise DataError("an impossible HyperSlab", where=self.where, found=f"{len(inner)} items", allowed=2)
        slab, whole = self.numbers(inner[0]).astype(np.int64).reshape(3, -1), self.numbers(inner[1])
        ends = slab[0] + slab[1] * (slab[2] - 1) + 1
        if slab.shape[1] != whole.ndim or slab[0].min() < 0 or slab[1:].min() < 1 or (ends > whole.shape).any():
            raise DataError("an impossible HyperSlab", where=self.where, found=slab.tolist(), allowed=whole.shape)
        parts = zip(slab[0].tolist(), ends.tolist(), slab[1].tolist(), strict=True)
        return whole[tuple(slice(*each) for each in parts)]


def _content(element: Element) -> object:
    """Return what an element says, so that equal meshes are found."""
    items = [(tuple(sorted(each.attrib.items())), (each.text or "").strip()) for each in element.iter()]
    return _tag(element), *items


def _mixed(numbers: NDArray[np.int64], where: str) -> list[Block]:
    """Return the cells of a mixed topology, in which each begins with the number of its kind."""
    blocks, at, listed = list[tuple[str, list[list[int]]]](), 0, numbers.tolist()
    while at < len(listed):
        kind = NUMBERS.get(listed[at], "")
        begin = at + 2 if kind in ("vertex", "line", "polygon") else at + 1
        width = nodes_of(kind) if begin == at + 1 else listed[at + 1] if at + 1 < len(listed) else 0
        if width < 1 or begin + width > len(listed):
            found = f"{listed[at : at + 12]} at {at}"
            raise DataError("not cells", where=where, found=found, allowed=f"kinds {', '.join(map(str, NUMBERS))}")
        if not blocks or blocks[-1][0] != kind or len(blocks[-1][1][-1]) != width:
            blocks.append((kind, []))
        blocks[-1][1].append(listed[begin : begin + width])
        at = begin + width
    return [(kind, np.array(rows, np.int64)) for kind, rows in blocks]
