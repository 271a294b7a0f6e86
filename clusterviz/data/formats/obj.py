"""OBJ, of Wavefront: vertices, polygons (f), polylines (l) and points (p) as text.

Positions are read, and colours of vertices (as `RGB`). Normals and texture coordinates belong to corners, not to
vertices; they are ignored, as are materials, groups and free-form curves.

References
----------
Wavefront Technologies: Advanced Visualizer Manual, appendix B1, Object Files.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import readable, require_file
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points, check_indices, triangulate
from clusterviz.errors import DataError

ELEMENTS = {b"f": 3, b"l": 2, b"p": 1}  # and their fewest corners


def read_obj(path: Path) -> Geometry:
    """Read an OBJ file.

    Raises
    ------
    DataError
        No vertices, no numbers, too few corners, or indices out of range.
    """
    where = str(path)
    require_file(path)
    with readable(path):
        content = path.read_bytes().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    rows: list[list[bytes]] = []
    found: dict[bytes, list[list[int]]] = {key: [] for key in ELEMENTS}
    for line in content.splitlines():
        words = line.split()
        if not words or words[0] not in (b"v", *ELEMENTS):
            continue
        if words[0] == b"v":
            rows.append(words[1:])
            continue
        indices = [int(word.partition(b"/")[0]) for word in words[1:]]
        if len(indices) < ELEMENTS[words[0]] or 0 in indices:
            allowed = f"at least {ELEMENTS[words[0]]} indices from 1, or from −1 backwards"
            raise DataError(
                "truncated or damaged", where=where, found=repr(line.decode("utf-8", "replace")), allowed=allowed
            )
        # A negative index counts back from the last vertex so far; −1 is out of range if it counts too far.
        found[words[0]].append([n - 1 if n > 0 else max(len(rows) + n, -1) for n in indices])
    if not rows:
        raise DataError("no vertices", where=where, allowed="lines that begin with v")
    if {len(row) for row in rows} - {3, 4, 6, 7}:
        raise DataError("truncated or damaged: a vertex is not 3, 4, 6 or 7 numbers", where=where)
    width = min(len(row) for row in rows)
    numbers = np.array([row[:width] for row in rows], "S").astype(np.float64)
    vertices, colours = numbers[:, :3], {"RGB": numbers[:, -3:]} if width > 4 else {}
    (polygons, corners), (lines, along), (_, dots) = (_joined(found[key]) for key in ELEMENTS)
    for each in (corners, along, dots):
        check_indices(each, len(rows), where)
    if not corners.size + along.size + dots.size:
        dots = np.arange(len(rows))
    mesh = Mesh(where, vertices, triangulate(polygons, corners)[0], colours) if corners.size else None
    paths = Lines(where, vertices[along], lines, {name: array[along] for name, array in colours.items()})
    points = Points(where, vertices[dots], {name: array[dots] for name, array in colours.items()})
    return Geometry(mesh, paths if along.size else None, points if dots.size else None)


def _joined(elements: list[list[int]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return offsets (k + 1,) and indices of elements."""
    offsets = np.concatenate([[0], np.cumsum([len(one) for one in elements])]).astype(np.int64)
    return offsets, np.fromiter((index for one in elements for index in one), np.int64, int(offsets[-1]))
