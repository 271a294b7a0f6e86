"""Streamlines of tractography: TrackVis (.trk) and MRtrix (.tck); nibabel reads the file.

Points are scanner coordinates (right, anterior, superior; mm). Numbers of points and of lines are attributes.
"""

from __future__ import annotations

import logging
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.files import require_file
from clusterviz.data.geometry import Attributes, Geometry, Lines
from clusterviz.data.header import check_size
from clusterviz.errors import DataError

TRK_HEADER = 1000  # bytes


def read_streamlines(path: Path) -> Geometry:
    """Read all streamlines of a file.

    Raises
    ------
    DataError
        Damaged or truncated, or another number of lines than the header says.
    """
    streamlines: Any = import_module("nibabel.streamlines")
    where, size = str(path), require_file(path, (b"TRACK", b"mrtrix tracks"))
    if path.suffix.lower() == ".trk":
        _check_trk(path, size)
    logger = logging.getLogger("nibabel.global")
    disabled, logger.disabled = logger.disabled, True  # of headers without an orientation, which then is taken as RAS
    try:
        tractogram = streamlines.load(path)
    finally:
        logger.disabled = disabled
    found, header = tractogram.streamlines, tractogram.header
    stated = int(header.get("count" if path.suffix.lower() == ".tck" else "nb_streamlines", 0))
    if stated and stated != len(found):
        raise DataError("truncated, or the header lies", where=where, found=f"{len(found)} lines", allowed=stated)
    lengths = np.array([len(line) for line in found], np.int64)
    points = found.get_data().reshape(-1, 3) if len(found) else np.empty((0, 3), np.float32)
    points = points.astype(np.promote_types(points.dtype, np.float32), copy=False)
    of_points = {name: rows.get_data() for name, rows in tractogram.tractogram.data_per_point.items()}
    of_lines = {name: np.asarray(rows) for name, rows in tractogram.tractogram.data_per_streamline.items()}
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return Geometry(lines=Lines(where, points, offsets, _flat(of_points), _flat(of_lines)))


def _check_trk(path: Path, size: int) -> None:
    """Check that the file holds whole lines before memory is taken for them.

    Raises
    ------
    DataError
        It does not.
    """
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
    """Return columns (n, 1) as (n,)."""
    return {name: array[:, 0] if array.shape[1:] == (1,) else array for name, array in arrays.items()}
