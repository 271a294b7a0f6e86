"""NIfTI-1 and -2 (.nii, .nii.gz), of neuroimaging; nibabel reads the header.

The world is the header's (right, anterior, superior; usually mm): by its sform, else qform, else the voxel sizes, as
its codes say; the qform also for an sform that is singular. `scl_slope` and `scl_inter` are applied; the samples are
then float32, or float64 if float32 cannot hold the stored type. The fourth axis is time, the fifth the components of
vectors (channels).
"""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, select
from clusterviz.data.files import explained, kind_of, refuse_array, require_file, start_of
from clusterviz.data.header import check_dtype, check_packed, check_size, make_grid
from clusterviz.data.source import Grid
from clusterviz.data.storage import FileBytes, FileRange, Storage, StreamBytes, StridedSource
from clusterviz.errors import DataError, warn_of_data


def open_nifti(path: Path, subset: Subset) -> StridedSource:
    """Open a volume, or one time step and component of several, in a NIfTI file."""
    where, packed = str(path), path.name.lower().endswith(".gz")
    size = require_file(path)
    refuse_array(subset.array, path)
    affine, proxy, intent = _read_header(path)
    stored = np.dtype(proxy.dtype)
    dtype = check_dtype(stored, where)
    slab, grid = placed_volume(proxy.shape, affine, subset, where)
    grid = replace(grid, modality="labels" if intent == "label" else "")
    offset, strides = slab.strides(stored.itemsize)
    storage: Storage
    if packed:
        check_packed(size, proxy.offset + slab.samples * stored.itemsize, "gzip", where)
        storage = StreamBytes(path, gzip.open, keep=max(strides))
    else:
        check_size(size, proxy.offset + slab.samples * stored.itemsize, where)
        storage = FileBytes([FileRange(path, 0, size)])
    scale = None
    if (proxy.slope, proxy.inter) != (1.0, 0.0):
        scale = float(proxy.slope), float(proxy.inter)
        dtype = np.result_type(dtype, np.float32)
    name = where + slab.label
    return StridedSource(name, grid, dtype, storage, stored, proxy.offset + offset, strides, scale, slab)


def placed_volume(
    shape: Sequence[int], affine: NDArray[np.float64], subset: Subset, where: str
) -> tuple[Hyperslab, Grid]:
    """Return the part of an image of nibabel that a subset names, and its grid.

    Parameters
    ----------
    shape : along x, y, z, time, component
    affine : float64 (4, 4), world from index
    """
    shape = (*shape, 1, 1, 1)[: max(3, len(shape))]
    slab = select(shape[::-1], "ZCTZYX"[-len(shape) :].rjust(len(shape), "Z"), subset, where)
    return slab, replace(make_grid(slab.shape_zyx, affine[:3, :3], affine[:3, 3], where), orientation="RAS")


def _read_header(path: Path) -> tuple[Any, Any, str]:
    import nibabel  # slow to import

    found = None if path.name.lower().endswith(".gz") else kind_of(start_of(path))
    with explained("wrong magic or damaged header", path, found=found, allowed="NIfTI-1 or NIfTI-2"):
        image: Any = nibabel.load(path)
        if not isinstance(image, nibabel.Nifti1Image):
            raise DataError("not NIfTI", where=str(path), found=type(image).__name__)
        header: Any = image.header
        return _affine(header, path), image.dataobj, str(header.get_intent()[0])


def _affine(header: Any, path: Path) -> NDArray[np.float64]:
    """Return the affine that the header's codes name, float64 (4, 4); the qform for a singular sform."""
    affine, has_qform = header.get_best_affine(), int(header["qform_code"]) > 0
    if int(header["sform_code"]) > 0 and has_qform and not _is_regular(affine):
        with suppress(ValueError):  # of impossible rotations
            if _is_regular(header.get_qform()):
                affine = header.get_qform()
                warn_of_data("the sform is singular: the qform is used", where=str(path))
    return np.asarray(affine, float)


def _is_regular(affine: NDArray[np.float64]) -> bool:
    return bool(np.isfinite(affine).all() and np.linalg.det(affine[:3, :3]) != 0)
