"""STL, of stereolithography and CAD: triangles by their corners, ascii or binary.

Equal corners become one vertex. The two bytes of each binary triangle become the attribute `stl` unless all are 0.
Stored normals are ignored.

References
----------
M. Burns: Automated Fabrication, 1993, section 6.5 (the StL format).
"""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

import numpy as np

from clusterviz.data.files import read_file
from clusterviz.data.geometry import Geometry, Mesh, merge_equal
from clusterviz.data.storage import numbers_of_words
from clusterviz.errors import DataError

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
    """Return the corners, float32 (3m, 3)."""
    words, ends = VERTEX.findall(content), [word.lower() for word in END.findall(content)]
    facets, is_ended = ends.count(b"facet"), ends[-1:] == [b"solid"]
    if len(words) != 3 * facets or not is_ended:
        found = f"{facets} endfacet, {len(words)} vertices, {'an' if is_ended else 'no'} endsolid at the end"
        raise DataError("truncated or damaged", where=where, found=found, allowed="three vertices in each facet")
    try:
        return numbers_of_words(list(chain.from_iterable(words)), np.float64).astype(np.float32).reshape(-1, 3)
    except ValueError as error:
        raise DataError(f"not a number: {error}", where=where) from error
