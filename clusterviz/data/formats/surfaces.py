"""Surfaces of neuroimaging, which nibabel reads: GIFTI (.gii, .gii.gz), and FreeSurfer's (lh.pial, rh.white, …).

Positions of GIFTI are those of the file, without its coordinate transforms. Further arrays with one entry a vertex are
attributes, named by their `Name`, else by their intent.

FreeSurfer's files are known by their first bytes. Positions are scanner coordinates (right, anterior, superior; mm), as
those of volumes: the file's own coordinates, plus the centre of the volume where the file states it (`cras`).
"""

from __future__ import annotations

import gzip
import re
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.data.files import readable
from clusterviz.data.geometry import Geometry, Mesh
from clusterviz.data.header import check_size
from clusterviz.errors import DataError

nibabel: Any = import_module("nibabel")  # whose functions have no types
DIMENSIONALITY = re.compile(rb"Dimensionality\s*=\s*[\"'](\d{1,30})")
MAX_AXES = 6  # of an array
POINTS, TRIANGLES = "NIFTI_INTENT_POINTSET", "NIFTI_INTENT_TRIANGLE"
MAX_COMMENT = 1 << 16  # bytes


def read_gifti(path: Path) -> Geometry:
    where, packed = str(path), path.name.lower().endswith(".gz")
    with readable(path), gzip.open(path) if packed else path.open("rb") as file:
        axes = [int(number) for number in DIMENSIONALITY.findall(file.read())]
    if max(axes, default=0) > MAX_AXES:  # nibabel counts up to it
        raise DataError("impossible Dimensionality", where=where, found=max(axes), allowed=f"at most {MAX_AXES}")
    image = nibabel.load(path)
    if not isinstance(image, nibabel.GiftiImage):
        raise DataError("not GIFTI", where=where, found=type(image).__name__)
    surfaces = [image.get_arrays_from_intent(intent) for intent in (POINTS, TRIANGLES)]
    if not all(surfaces):
        held = ", ".join(_name(each) for each in image.darrays) or "nothing"
        raise DataError("no surface", where=where, found=held, allowed=f"{POINTS} and {TRIANGLES}")
    vertices, triangles = (np.asarray(each[0].data) for each in surfaces)
    vertices = vertices.astype(np.promote_types(vertices.dtype, np.float32).newbyteorder("="), copy=False)
    others = [each for each in image.darrays if each is not surfaces[0][0] and each is not surfaces[1][0]]
    arrays = {_name(each): np.asarray(each.data) for each in others}
    fitting = {name: array for name, array in arrays.items() if array.shape[:1] == vertices.shape[:1]}
    return Geometry(mesh=Mesh(where, vertices, triangles.astype(np.int64), fitting))


def _name(array: Any) -> str:
    intent = str(nibabel.nifti1.intent_codes.niistring[array.intent])
    return str(array.meta.get("Name") or intent.removeprefix("NIFTI_INTENT_").lower())


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
        vertices, triangles, volume = nibabel.freesurfer.read_geometry(path, read_metadata=True)
    centre = volume.get("cras", np.zeros(3)) if str(volume.get("valid", "0")).startswith("1") else np.zeros(3)
    return Geometry(mesh=Mesh(where, (vertices + centre).astype(np.float32), triangles.astype(np.int64)))
