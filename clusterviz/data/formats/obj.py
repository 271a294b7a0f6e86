"""OBJ, of Wavefront: vertices, polygons (f), polylines (l) and points (p) as text.

Positions are read, and colours of vertices (as `RGB`, see `scaled_colours`). Normals and texture coordinates belong to
corners, not to vertices; they are ignored, as are groups, and with a warning materials and free-form shapes.

References
----------
Wavefront Technologies: Advanced Visualizer Manual, appendix B1, Object Files.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import read_file
from clusterviz.data.geometry import Geometry, Lines, Mesh, Points, check_indices, scaled_colours, triangulate
from clusterviz.data.storage import numbers_of_words
from clusterviz.errors import DataError, warn_of_data

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
