"""FreeSurfer's surfaces (lh.pial, rh.white, …), known by their first bytes; nibabel reads the file.

Positions are scanner coordinates (right, anterior, superior; mm), as those of volumes: the file's own coordinates, plus
the centre of the volume where the file states it (`cras`).
"""

from __future__ import annotations

import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.data.files import readable
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.data.header import check_size
from clusterviz.errors import DataError

MAX_COMMENT = 1 << 16  # bytes


def read_freesurfer(path: Path) -> Geometry:
    """Read a surface of triangles."""
    where, size = str(path), path.stat().st_size
    with readable(path), path.open("rb") as file:
        head = file.read(MAX_COMMENT)
    begin = head.find(b"\n\n") + 2  # the comment ends in two line feeds
    if begin < 2 or len(head) < begin + 8:
        raise DataError("truncated, or the comment has no end", where=where)
    vertex_count, triangle_count = np.frombuffer(head, ">i4", 2, begin).tolist()
    if min(vertex_count, triangle_count) < 0:
        raise DataError("impossible counts", where=where, found=f"{vertex_count} vertices, {triangle_count} triangles")
    check_size(size, begin + 8 + 12 * (vertex_count + triangle_count), where)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of files without the volume's geometry
        freesurfer: Any = import_module("nibabel.freesurfer")
        vertices, triangles, volume = freesurfer.read_geometry(path, read_metadata=True)
    centre = volume.get("cras", np.zeros(3)) if str(volume.get("valid", "0")).startswith("1") else np.zeros(3)
    return Geometry(mesh=Mesh(where, (vertices + centre).astype(np.float32), triangles.astype(np.int64)))
