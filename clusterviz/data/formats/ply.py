"""PLY, the Stanford polygon file format: ascii, or binary of either byte order.

Properties of vertices and faces become attributes; nx, ny, nz become `Normals`, and red, green, blue (and alpha) become
`RGB` or `RGBA`, see `scaled_colours`. Vertices without faces are points. Faces are polygons, or strips in `tristrips`,
with −1 between them. Binary files are mapped into memory: positions and triangles are views of them, of which only used
pages are read.

References
----------
G. Turk: The PLY Polygon File Format, Stanford 1994.
"""

from __future__ import annotations

import mmap
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import explained, readable
from clusterviz.data.geometry import Geometry, Mesh, Points, scaled_colours, triangulate, triangulate_strips
from clusterviz.data.header import check_packed, check_size
from clusterviz.data.storage import numbers_of_words
from clusterviz.errors import DataError

TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"}
TYPES |= {f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)}
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
TUPLES = {"Normals": ("nx", "ny", "nz"), "RGBA": ("red", "green", "blue", "alpha"), "RGB": ("red", "green", "blue")}
MAX_HEADER = 1 << 16  # bytes


@dataclass(frozen=True)
class _Property:
    """Number of each row of an element, or list of numbers with its length before it."""

    name: str
    dtype: str
    length: str = ""


@dataclass
class _Element:
    """Columns (count,) of numbers by name, and lists: items (count, k), or offsets (count + 1,) and items."""

    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)
    columns: dict[str, NDArray[Any]] = field(default_factory=dict)
    lists: dict[str, NDArray[Any] | tuple[NDArray[np.int64], NDArray[Any]]] = field(default_factory=dict)


def read_ply(path: Path) -> Geometry:
    where = str(path)
    with readable(path), path.open("rb") as file:
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    form, elements, begin = _header(content, where)
    data = memoryview(content)[begin:]
    if form == "ascii":
        data, order = _numbers(data, elements, where), "="
    else:
        order = ORDERS[form]
    for element in elements:
        data = _read(data, element, order, form == "ascii", where)
    if form == "ascii" and len(data):
        raise DataError("longer than the header says", where=where, found=f"{len(data) // 8} more numbers")
    by_name = {element.name: element for element in elements}
    vertex, face = by_name.get("vertex", _Element("vertex", 0)), by_name.get("face", _Element("face", 0))
    if any(axis not in vertex.columns for axis in "xyz"):
        raise DataError("no vertices", where=where, found=", ".join(vertex.columns), allowed="properties x, y, z")
    vertices = _joined([vertex.columns.pop(axis) for axis in "xyz"])
    vertices = vertices.astype(np.promote_types(vertices.dtype, np.float32), copy=False)
    attributes = _attributes(vertex.columns)
    polygons = next((face.lists[name] for name in ("vertex_indices", "vertex_index") if name in face.lists), None)
    strips = by_name.get("tristrips", _Element("", 0)).lists.get("vertex_indices")
    if polygons is not None and face.count:
        faces = _attributes(face.columns)
        if isinstance(polygons, np.ndarray) and polygons.shape[1] == 3:
            triangles = polygons
        else:
            triangles, polygon = triangulate(*_offsets(polygons))
            faces = {name: array[polygon] for name, array in faces.items()}
        return Geometry(mesh=Mesh(where, vertices, triangles, attributes, faces))
    if strips is not None:
        corners = _offsets(strips)[1].astype(np.int64)
        ends = np.flatnonzero(np.append(corners, -1) == -1)
        offsets = np.concatenate([[0], ends - np.arange(len(ends))])
        return Geometry(mesh=Mesh(where, vertices, triangulate_strips(offsets, corners[corners != -1])[0], attributes))
    return Geometry(points=Points(where, vertices, attributes))


def _joined(columns: list[NDArray[Any]]) -> NDArray[Any]:
    """Return columns as one array (n, k): a view if they are neighbours in rows of one type."""
    first = columns[0]
    begins = [each.ctypes.data - k * first.itemsize for k, each in enumerate(columns)]
    if not first.size or len({(at, *each.strides, each.dtype) for at, each in zip(begins, columns, strict=True)}) > 1:
        return np.stack(columns, axis=1)
    strides = (*first.strides, first.itemsize)
    return np.lib.stride_tricks.as_strided(first, (len(first), len(columns)), strides, writeable=False)


def _offsets(lists: NDArray[Any] | tuple[NDArray[np.int64], NDArray[Any]]) -> tuple[NDArray[np.int64], NDArray[Any]]:
    return lists if isinstance(lists, tuple) else (np.arange(len(lists) + 1) * lists.shape[1], lists.reshape(-1))


def _header(content: mmap.mmap, where: str) -> tuple[str, list[_Element], int]:
    end = content.find(b"end_header", 0, MAX_HEADER)
    line_end = content.find(b"\n", end)
    if end < 0 or line_end < 0:
        raise DataError("truncated: the header has no end", where=where, allowed="end_header")
    form, elements = "", list[_Element]()
    for line in content[:end].decode("utf-8", "replace").splitlines()[1:]:
        words = line.split()
        match words:
            case [] | ["comment", *_] | ["obj_info", *_]:
                continue
            case ["format", str(form), "1.0"] if form in ORDERS:
                continue
            case ["element", name, count] if count.isdecimal() and len(count) < 19:
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= TYPES.keys():
                elements[-1].properties.append(_Property(name, TYPES[kind], TYPES[length]))
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties.append(_Property(name, TYPES[kind]))
            case _:
                raise DataError("the header is not understood", where=where, found=repr(line))
    if not form:
        raise DataError("the header has no format", where=where, allowed=", ".join(ORDERS))
    for element in elements:
        names = [each.name for each in element.properties]
        if len(set(names)) != len(names):
            raise DataError("a property has two entries", where=where, found=f"element {element.name}: {names}")
    return form, elements, line_end + 1


def _numbers(data: memoryview, elements: list[_Element], where: str) -> memoryview:
    """Return text as float64 numbers, so that it is read as binary data is."""
    check_packed(len(data), sum(each.count * len(each.properties) for each in elements), "text", where)
    with explained("not a number", where, ValueError):
        return memoryview(numbers_of_words(bytes(data).split(), np.float64).tobytes())


def _read(data: memoryview, element: _Element, order: str, text: bool, where: str) -> memoryview:
    def stored(kind: str) -> np.dtype[Any]:
        return np.dtype("f8" if text else order + kind)

    begin, lengths = 0, list[int]()
    for each in element.properties if element.count else []:
        if each.length:  # the first row tells the lengths, which are those of all rows in most files
            check_size(len(data), begin + stored(each.length).itemsize, where)
            lengths.append(_length(data, begin, stored(each.length), where))
            begin += stored(each.length).itemsize + lengths[-1] * stored(each.dtype).itemsize
        else:
            begin += stored(each.dtype).itemsize
    sizes, fields = iter(lengths), list[Any]()
    for number, each in enumerate(element.properties if element.count else []):
        if each.length:
            fields += [(f"n{number}", stored(each.length)), (str(number), stored(each.dtype), (next(sizes),))]
        else:
            fields.append((str(number), stored(each.dtype)))
    row = np.dtype(fields)
    needed = element.count * row.itemsize
    rows = np.frombuffer(data[: needed if needed <= len(data) else 0], row) if row.itemsize else np.empty(0, row)
    counts = [(f"n{number}", each) for number, each in enumerate(element.properties) if each.length]
    alike = len(rows) == element.count or not row.itemsize
    if alike and all((rows[n] == length).all() for (n, _), length in zip(counts, lengths, strict=False)):
        for number, each in enumerate(element.properties):
            found = rows[str(number)] if len(rows) else np.empty((0, 0) if each.length else 0)
            if each.length:
                element.lists[each.name] = _typed(found, each)
            else:
                element.columns[each.name] = _typed(found.reshape(-1), each)
        return data[needed:]
    if not counts:
        check_size(len(data), needed, where)
    return _read_rows(data, element, stored, where)


def _read_rows(data: memoryview, element: _Element, stored: Any, where: str) -> memoryview:
    parts: list[list[NDArray[Any]]] = [[] for _ in element.properties]
    at, types = 0, [(stored(each.length) if each.length else None, stored(each.dtype)) for each in element.properties]
    for _ in range(element.count):
        for (length, dtype), part in zip(types, parts, strict=True):
            count = 1
            if length is not None:
                check_size(len(data), at + length.itemsize, where)
                count = _length(data, at, length, where)
                at += length.itemsize
            check_size(len(data), at + count * dtype.itemsize, where)
            part.append(np.frombuffer(data, dtype, count, at))
            at += count * dtype.itemsize
    for each, part in zip(element.properties, parts, strict=True):
        items = _typed(np.concatenate(part), each)
        if each.length:
            offsets = np.cumsum([0, *(len(one) for one in part)], dtype=np.int64)
            element.lists[each.name] = offsets, items
        else:
            element.columns[each.name] = items
    return data[at:]


def _length(data: memoryview, at: int, dtype: np.dtype[Any], where: str) -> int:
    """Return the length of a list, which is a whole number that the data can hold."""
    length = float(np.frombuffer(data, dtype, 1, at)[0])
    if not 0 <= length <= len(data) or length % 1:
        raise DataError("truncated, or the header lies about its size", where=where, found=f"a list of {length:g}")
    return int(length)


def _typed(items: NDArray[Any], each: _Property) -> NDArray[Any]:
    with np.errstate(invalid="ignore"):
        return items.astype(each.dtype, copy=False)


def _attributes(columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return columns by name, with those that belong together as one array (n, components)."""
    left, found = dict(columns), dict[str, NDArray[Any]]()
    for name, parts in TUPLES.items():
        if all(part in left for part in parts):
            found[name] = np.stack([left.pop(part) for part in parts], axis=1)
            if name.startswith("RGB"):
                found[name] = scaled_colours(found[name])
    return found | left
