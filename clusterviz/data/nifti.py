"""NIfTI-1 and -2 (.nii, .nii.gz), as used in neuroimaging: nibabel reads the header, boxes are read here.

The world is the header's (right, anterior, superior; usually mm), by nibabel's choice of affine: sform, else qform,
else the voxel sizes. `scl_slope` and `scl_inter` are applied; the samples are then float32, or float64 where float32
could not hold the stored type. Of a file with several time steps, `array` is the number of one.
"""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clusterviz.data.files import refuse_array, require_file
from clusterviz.data.header import check_dtype, check_shape, check_size, place
from clusterviz.data.linear import LinearSource
from clusterviz.data.source import Index
from clusterviz.data.storage import FileBytes, Piece, Storage, StreamBytes
from clusterviz.errors import DataError


def open_nifti(path: Path, array: str | None = None) -> LinearSource:
    """A volume, or one time step of several, in a NIfTI file.

    Raises
    ------
    DataError
        Not NIfTI, truncated, several time steps and none chosen, vectors or colours, or a singular affine.
    """
    where, packed = str(path), path.name.lower().endswith(".gz")
    size = require_file(path, (b"\x1f\x8b",) if packed else ())
    affine, proxy = _read_header(path)
    stored = np.dtype(proxy.dtype)
    dtype = check_dtype(stored, where)
    shape_zyx, step, steps = _choose_step(tuple(int(n) for n in proxy.shape), array, path)
    grid = replace(place(shape_zyx, affine[:3, :3], affine[:3, 3], where), orientation="RAS")
    volume_bytes = int(np.prod(shape_zyx, dtype=object)) * stored.itemsize
    storage: Storage
    if packed:
        plane_bytes = volume_bytes // shape_zyx[0]
        storage = StreamBytes(path, gzip.open, keep=plane_bytes)
    else:
        check_size(size, proxy.offset + steps * volume_bytes, where)
        storage = FileBytes([Piece(path, 0, size)])
    scale = None
    if (proxy.slope, proxy.inter) != (1.0, 0.0):
        scale = float(proxy.slope), float(proxy.inter)
        dtype = np.result_type(dtype, np.float32)
    name = f"{path}:{step}" if steps > 1 else where
    return LinearSource(name, grid, dtype, storage, stored, proxy.offset + step * volume_bytes, scale=scale)


def _read_header(path: Path) -> tuple[Any, Any]:
    """nibabel's affine (4, 4) and array proxy: shape, dtype, offset, slope, inter."""
    import nibabel

    try:
        image: Any = nibabel.load(path)
        if not isinstance(image, nibabel.Nifti1Image):
            raise DataError("not NIfTI", where=str(path), found=type(image).__name__)
        return np.asarray(image.affine, float), image.dataobj
    except DataError:
        raise
    except Exception as error:  # a damaged header makes nibabel raise many kinds
        text = " ".join(str(error).split())
        raise DataError(
            f"wrong magic or damaged header: {text}", where=str(path), allowed="NIfTI-1 or NIfTI-2"
        ) from error


def _choose_step(shape: tuple[int, ...], array: str | None, path: Path) -> tuple[Index, int, int]:
    """The shape (z, y, x) of one time step, its number, and how many there are; `shape` is (x, y, z, t, …)."""
    check_shape([min(shape, default=0), 1, 1], str(path))
    x, y, z, steps, *more = (*shape, 1, 1, 1, 1)[: max(4, len(shape))]
    if max(more, default=1) > 1:
        raise DataError("not a scalar volume", where=str(path), found=f"axes {shape}", allowed="x, y, z and time")
    if steps == 1 and array != "0":
        refuse_array(array, path)
    if steps > 1 and (array is None or array not in map(str, range(steps))):
        what = "several time steps: name one as the array" if array is None else "no such time step"
        raise DataError(what, where=str(path), found=array or f"{steps} time steps", allowed=f"0 to {steps - 1}")
    return check_shape([z, y, x], str(path)), int(array or 0), steps
