"""Surfaces and streamlines of neuroimaging, which nibabel reads.

Surfaces are GIFTI (.gii, .gii.gz), and FreeSurfer's (lh.pial, rh.white, …); streamlines TrackVis (.trk), and MRtrix
(.tck), which is read here, since nibabel reads MRtrix's files of 32 bits only.

Positions of GIFTI are those of the file, without its coordinate transforms. Further arrays with one entry a vertex are
attributes, named by their `Name`, else by their intent.

FreeSurfer's files are known by their first bytes. Positions are scanner coordinates (right, anterior, superior; mm), as
those of volumes: the file's own coordinates, plus the centre of the volume where the file states it (`cras`). So are
points of streamlines, whose numbers are attributes.

References
----------
MRtrix3 documentation: Image and other file formats, "Tracks file format (.tck)".
"""

from __future__ import annotations

import gzip
import logging
import re
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import readable, require_file
from clusterviz.data.geometry import Attributes, Geometry, Lines, Mesh
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


TRK_HEADER, MAX_LINE = 1000, 1 << 16  # bytes
TCK_TYPES = {"Float32LE": "<f4", "Float32BE": ">f4", "Float64LE": "<f8", "Float64BE": ">f8"}


def read_tck(path: Path) -> Geometry:
    where, size, header, at_end = str(path), require_file(path, (b"mrtrix tracks",)), dict[str, str](), False
    with readable(path), path.open("rb") as file:
        while not at_end and (line := file.readline(MAX_LINE)):
            key, _, value = line.decode("utf-8", "replace").partition(":")
            header[key.strip()], at_end = value.strip(), key.strip() == "END"
        name, _, begin = header.get("file", "").partition(" ")
        if not at_end or name != "." or not begin.strip().isdecimal():
            raise DataError("damaged header", where=where, found=header.get("file"), allowed="file: . OFFSET, and END")
        kind = header.get("datatype", "")
        if kind not in TCK_TYPES:
            raise DataError("damaged: no such type", where=where, found=kind, allowed=", ".join(TCK_TYPES))
        stored = np.dtype(TCK_TYPES[kind])
        file.seek(int(begin))
        content = file.read()
    triples = np.frombuffer(content, stored, len(content) // stored.itemsize // 3 * 3).reshape(-1, 3)
    ends = np.flatnonzero(np.isinf(triples).all(axis=1))
    if not len(ends):
        raise DataError("truncated: no end mark", where=where, found=f"{size} bytes")
    triples = triples[: ends[0]].astype(stored.newbyteorder("="))
    marks = np.isnan(triples).all(axis=1)
    offsets = np.flatnonzero(np.append(True, marks)) - np.arange(int(marks.sum()) + 1)
    if len(marks) and not marks[-1]:  # the last line needs no mark
        offsets = np.append(offsets, len(marks) - int(marks.sum()))
    _check_count(header.get("count", "0"), len(offsets) - 1, where)
    return Geometry(lines=Lines(where, np.ascontiguousarray(triples[~marks]), offsets))


def _check_count(stated: Any, found: int, where: str) -> None:
    """Check the number of lines against the header's, which is 0 where the program that wrote it did not know it."""
    if int(stated) not in (0, found):
        raise DataError("truncated, or the header lies", where=where, found=f"{found} lines", allowed=int(stated))


def read_trk(path: Path) -> Geometry:
    where, size = str(path), require_file(path, (b"TRACK",))
    _check_trk(path, size)
    logger = logging.getLogger("nibabel.global")
    disabled, logger.disabled = logger.disabled, True  # of headers without an orientation, which then is taken as RAS
    try:
        tractogram = nibabel.streamlines.load(path)
    finally:
        logger.disabled = disabled
    found, header = tractogram.streamlines, tractogram.header
    _check_count(header.get("nb_streamlines", 0), len(found), where)
    lengths = np.array([len(line) for line in found], np.int64)
    points = found.get_data().reshape(-1, 3) if len(found) else np.empty((0, 3), np.float32)
    points = points.astype(np.promote_types(points.dtype, np.float32), copy=False)
    of_points = {name: rows.get_data() for name, rows in tractogram.tractogram.data_per_point.items()}
    of_lines = {name: np.asarray(rows) for name, rows in tractogram.tractogram.data_per_streamline.items()}
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return Geometry(lines=Lines(where, points, offsets, _flat(of_points), _flat(of_lines)))


def _check_trk(path: Path, size: int) -> None:
    """Check that the file holds whole lines before memory is taken for them."""
    content = np.memmap(path, np.uint8, "r")
    check_size(size, TRK_HEADER, str(path))
    order = "<" if int(content[996:1000].view("<i4")[0]) == TRK_HEADER else ">"
    scalars, properties = int(content[36:38].view(order + "i2")[0]), int(content[238:240].view(order + "i2")[0])
    if min(scalars, properties) < 0:
        raise DataError("impossible counts", where=str(path), found=f"{scalars} scalars, {properties} properties")
    at = TRK_HEADER
    while at < size:
        check_size(size, at + 4, str(path))
        length = int(content[at : at + 4].view(order + "i4")[0])
        if length < 0:
            raise DataError("a line has an impossible length", where=str(path), found=length)
        at += 4 + 4 * (length * (3 + scalars) + properties)
        check_size(size, at, str(path))


def _flat(arrays: Attributes) -> dict[str, NDArray[np.generic]]:
    return {name: array[:, 0] if array.shape[1:] == (1,) else array for name, array in arrays.items()}
