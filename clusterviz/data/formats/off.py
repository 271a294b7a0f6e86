"""OFF, of Geomview: vertices and polygons as text. The variants with colours (C) and normals (N) of vertices are read.

Colours of vertices, and of polygons if all have them, become `RGB` or `RGBA`, see `scaled_colours`; normals become
`Normals`.

References
----------
M. Phillips, S. Levy, T. Munzner: Geomview manual, section 4.2.5 (OFF files).
"""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import kind_of, read_file
from clusterviz.data.geometry import Geometry, Mesh, Points, scaled_colours, triangulate
from clusterviz.data.header import check_packed
from clusterviz.data.storage import numbers_of_words
from clusterviz.errors import DataError, warn_of_data

COLOURS = {3: "RGB", 4: "RGBA"}


def read_off(path: Path) -> Geometry:
    where, content = str(path), read_file(path)
    lines = [line for line in re.sub(rb"#[^\n]*", b"", content).splitlines() if line.strip()]
    start = re.match(rb"\s*(C?)(N?)OFF\b(.*)", lines[0]) if lines else None
    if not start or start[3].strip() == b"BINARY":
        found = kind_of(content[:348])
        raise DataError(
            "not OFF, or an unsupported variant", where=where, found=found, allowed="OFF, COFF, NOFF, CNOFF"
        )
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
