"""Meshes of few kinds of lines: OFF and OBJ, which are text, and STL, which is text or binary.

OFF, of Geomview: the variants with colours (C) and normals (N) of vertices are read. Colours of vertices, and of
polygons if all have them, become `RGB` or `RGBA`, see `scaled_colours`; normals become `Normals`.

OBJ, of Wavefront: vertices, polygons (f), polylines (l) and points (p). Positions are read, and colours of vertices.
Normals and texture coordinates belong to corners, not to vertices; they are ignored, as are groups, and with a warning
materials and free-form shapes.

STL, of stereolithography and CAD: triangles by their corners. Equal corners become one vertex. The two bytes of each
binary triangle become the attribute `stl` unless all are 0. Stored normals are ignored.

References
----------
M. Phillips, S. Levy, T. Munzner: Geomview manual, section 4.2.5 (OFF files).
Wavefront Technologies: Advanced Visualizer Manual, appendix B1, Object Files.
M. Burns: Automated Fabrication, 1993, section 6.5 (the StL format).
"""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import explained, kind_of, read_file
from clusterviz.data.geometry import (
    Geometry,
    Lines,
    Mesh,
    Points,
    check_indices,
    merge_equal,
    scaled_colours,
    triangulate,
)
from clusterviz.data.header import check_packed
from clusterviz.data.storage import numbers_of_words
from clusterviz.errors import DataError, warn_of_data

COLOURS = {3: "RGB", 4: "RGBA"}


def read_off(path: Path) -> Geometry:
    where, content = str(path), read_file(path)
    lines = [line for line in re.sub(rb"#[^\n]*", b"", content).splitlines() if line.strip()]
    start = re.match(rb"\s*(C?)(N?)OFF\b(.*)", lines[0]) if lines else None
    if not start or start[3].strip() == b"BINARY":
        found, allowed = kind_of(content[:348]), "OFF, COFF, NOFF, CNOFF"
        raise DataError("not OFF, or an unsupported variant", where=where, found=found, allowed=allowed)
    lines = [start[3], *lines[1:]] if start[3].strip() else lines[1:]
    counts = lines[0].split() if lines else []
    if len(counts) not in (2, 3) or not all(word.isdigit() and len(word) < 19 for word in counts):
        found = b" ".join(counts).decode("utf-8", "replace")
        raise DataError("no counts", where=where, found=repr(found), allowed="vertices, polygons, edges")
    vertex_count, polygon_count = int(counts[0]), int(counts[1])
    check_packed(len(content), vertex_count + polygon_count, "text", where)
    if len(lines) != 1 + vertex_count + polygon_count:
        allowed = f"{vertex_count} vertices and {polygon_count} polygons"
        what = "truncated, or the header lies about its size"
        raise DataError(what, where=where, found=f"{len(lines) - 1} lines", allowed=allowed)
    words = [line.split() for line in lines[1 : 1 + vertex_count]]
    if len({len(row) for row in words}) > 1:
        raise DataError("rows of different lengths", where=where)
    rows = numbers_of_words(list(chain.from_iterable(words)), np.float64)
    rows = rows.reshape(vertex_count, -1) if vertex_count else np.empty((0, 3))
    vertices, rest, attributes = rows[:, :3], rows[:, 3:], {}
    if start[2]:
        attributes["Normals"], rest = rest[:, :3], rest[:, 3:]
    if rest.shape[1] in COLOURS:
        attributes[COLOURS[rest.shape[1]]] = scaled_colours(rest)
    if not polygon_count:
        return Geometry(points=Points(where, vertices, attributes))
    words = [line.split() for line in lines[1 + vertex_count :]]
    lengths = [int(row[0]) for row in words]
    if any(not 0 <= length < len(row) for length, row in zip(lengths, words, strict=True)):
        raise DataError("truncated: a polygon has fewer corners than its line says", where=where)
    corners = chain.from_iterable(row[1 : 1 + length] for length, row in zip(lengths, words, strict=True))
    indices = np.fromiter(map(int, corners), np.int64)
    triangles, polygon = triangulate(np.concatenate([[0], np.cumsum(lengths)]), indices)
    colours = _of_polygons([row[1 + length :] for length, row in zip(lengths, words, strict=True)], where)
    faces = {name: array[polygon] for name, array in colours.items()}
    return Geometry(mesh=Mesh(where, vertices, triangles, attributes, faces))


def _of_polygons(words: list[list[bytes]], where: str) -> dict[str, NDArray[Any]]:
    """Return the colours behind the corners of all polygons; one number stands for an entry of a colour map."""
    counts = {len(row) for row in words}
    if len(counts) == 1 and counts <= COLOURS.keys():
        (count,) = counts
        numbers = numbers_of_words(list(chain.from_iterable(words)), np.float64)
        return {COLOURS[count]: scaled_colours(numbers.reshape(-1, count))}
    if counts != {0}:
        found = f"{', '.join(map(str, sorted(counts)))} numbers behind the corners"
        warn_of_data("the colours of polygons are not read", where=where, found=found, allowed="3 or 4 of all polygons")
    return {}


FEWEST = {b"f": 3, b"l": 2, b"p": 1}  # corners of an element
UNREAD = {b"usemtl": "materials", b"curv": "curves", b"surf": "free-form surfaces"}


def read_obj(path: Path) -> Geometry:
    where, content = str(path), read_file(path).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    rows: list[list[bytes]] = []
    unread = dict[str, None]()
    found = {key: _Elements() for key in FEWEST}
    for line in content.splitlines():
        words = line.split()
        if words and words[0] == b"v":
            rows.append(words[1:])
        elif words and words[0] in found:
            found[words[0]].add(words[1:], len(rows))
        elif words and words[0] in UNREAD:
            unread[UNREAD[words[0]]] = None
    if unread:
        warn_of_data("not read", where=where, found=", ".join(unread))
    if not rows:
        raise DataError("no vertices", where=where, allowed="lines that begin with v")
    if {len(row) for row in rows} - {3, 4, 6, 7}:
        raise DataError("truncated or damaged: a vertex is not 3, 4, 6 or 7 numbers", where=where)
    width = min(len(row) for row in rows)
    words = [word for row in rows for word in row[:width]]
    numbers = numbers_of_words(words, np.float64).reshape(-1, width)
    vertices, colours = numbers[:, :3], {"RGB": scaled_colours(numbers[:, -3:])} if width > 4 else {}
    (polygons, corners), (lines, along), (_, dots) = (
        found[key].joined(fewest, len(rows), where) for key, fewest in FEWEST.items()
    )
    if not corners.size + along.size + dots.size:
        dots = np.arange(len(rows))
    mesh = Mesh(where, vertices, triangulate(polygons, corners)[0], colours) if corners.size else None
    paths = Lines(where, vertices[along], lines, {name: array[along] for name, array in colours.items()})
    points = Points(where, vertices[dots], {name: array[dots] for name, array in colours.items()})
    return Geometry(mesh, paths if along.size else None, points if dots.size else None)


class _Elements:
    """Elements of one kind: the words of all corners, and of each element their number and that of vertices so far."""

    def __init__(self) -> None:
        self.words: list[bytes] = []
        self.lengths: list[int] = []
        self.seen: list[int] = []

    def add(self, corners: list[bytes], vertices: int) -> None:
        self.words += corners
        self.lengths.append(len(corners))
        self.seen.append(vertices)

    def joined(self, fewest: int, count: int, where: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return offsets (k + 1,) and indices of vertices, checked against their `count`."""
        offsets = np.concatenate([[0], np.cumsum(self.lengths)]).astype(np.int64)
        text = b" ".join(self.words)
        if b"/" in text:  # texture coordinates and normals
            text = re.sub(rb"/\S*", b"", text)
        stated = numbers_of_words(text.split(), np.int64)
        if len(stated) != len(self.words) or min(self.lengths, default=fewest) < fewest or not stated.all():
            allowed = f"at least {fewest} indices from 1, or from −1 backwards"
            raise DataError("truncated or damaged: an element lacks indices", where=where, allowed=allowed)
        if (stated < 0).any():  # counted back from the last vertex so far; −1 is out of range if it counts too far
            seen = np.repeat(self.seen, self.lengths)
            stated = np.where(stated < 0, np.maximum(seen + stated, -1) + 1, stated)
        check_indices(stated - 1, count, where)
        return offsets, stated - 1


HEADER = 84  # bytes, the last four of which are the number of triangles
TRIANGLE = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
FLAGS = re.MULTILINE | re.IGNORECASE
VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)[ \t]*\r?$", FLAGS)
END = re.compile(rb"^[ \t]*end(facet|solid)\b", FLAGS)


def read_stl(path: Path) -> Geometry:
    """Read an STL file; a file of exactly the size that a binary header states is binary."""
    where, content = str(path), read_file(path)
    size = len(content)
    stated = int(np.frombuffer(content[HEADER - 4 : HEADER].ljust(4, b"\0"), "<u4")[0])
    attributes = {}
    if size >= HEADER and size == HEADER + stated * TRIANGLE.itemsize:
        stored = np.frombuffer(content, TRIANGLE, stated, HEADER)
        corners = stored["corners"].astype(np.float32).reshape(-1, 3)
        if stored["attribute"].any():
            attributes["stl"] = stored["attribute"].astype(np.uint16)
    elif re.match(rb"\s*solid\b", content, re.IGNORECASE):
        corners = _ascii(content, where)
    else:
        allowed = f"{HEADER + stated * TRIANGLE.itemsize} for {stated} triangles, or text that begins with solid"
        raise DataError("not STL, truncated, or its header lies", where=where, found=f"{size} bytes", allowed=allowed)
    first, vertex = merge_equal(corners)
    return Geometry(mesh=Mesh(where, corners[first], vertex.reshape(-1, 3), {}, attributes))


def _ascii(content: bytes, where: str) -> np.ndarray:
    words, ends = VERTEX.findall(content), [word.lower() for word in END.findall(content)]
    facets, is_ended = ends.count(b"facet"), ends[-1:] == [b"solid"]
    if len(words) != 3 * facets or not is_ended:
        found = f"{facets} endfacet, {len(words)} vertices, {'an' if is_ended else 'no'} endsolid at the end"
        raise DataError("truncated or damaged", where=where, found=found, allowed="three vertices in each facet")
    with explained("not a number", where, ValueError):
        return numbers_of_words(list(chain.from_iterable(words)), np.float64).astype(np.float32).reshape(-1, 3)
