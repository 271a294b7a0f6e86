"""Folder of slices as a volume, one picture a layer in the order of the numbers in their names; and single pictures.

A folder without pictures may hold a DICOM series: see `clusterviz.data.formats.dicom`.

All slices must have the same size and type. The spacing within a slice is that of the first one; between slices it is 1
unless the scene sets it. Hidden files and files that are not pictures are ignored. Pillow reads pictures other than
TIFF: samples are grey values, or the `channel` of colours, which Pillow reduces from 16 to 8 bits. Of a picture with a
palette they are the luminance of its colours, or with `channel: index` its indices, which label maps have.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from clusterviz.data.axes import Hyperslab, Subset, select
from clusterviz.data.files import PICTURES, check_folder, explained, readable, refuse_array, require_file
from clusterviz.data.formats.dicom import is_dicom, open_series
from clusterviz.data.formats.tiff import open_tiff
from clusterviz.data.grid_files import by_numbers
from clusterviz.data.header import check_box, check_packed
from clusterviz.data.source import Grid, Index, Source
from clusterviz.errors import DataError, warn_of_data

PALETTE = ("luminance", "index")
"""Channels of a picture with a palette."""
NAMES = {"R": "red", "G": "green", "B": "blue", "A": "alpha", "L": "grey"}
TYPES = {"1": "u1", "I;16": "u2", "I;16L": "u2", "I;16B": "u2", "I;16N": "u2", "I": "i4", "F": "f4"}


@dataclass(frozen=True)
class PictureSource:
    """Picture that is decoded when it is read."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    path: Path
    slab: Hyperslab

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        if 0 in shape:
            return np.empty(shape, self.dtype)
        with explained("the picture cannot be decoded", self.name), Image.open(self.path) as image:
            pixels = np.asarray(image)
            if image.mode == "P":
                pixels = np.stack([np.asarray(image.convert("L")), pixels], axis=-1)
            pixels = pixels.reshape(self.slab.shape)
        (_, y, x), (_, y_end, x_end) = begin_zyx, end_zyx
        return np.array(pixels[y:y_end, x:x_end, self.slab.channel], self.dtype, order="C").reshape(shape)


def open_picture(path: Path, subset: Subset) -> PictureSource:
    size = require_file(path)
    refuse_array(subset.array, path)
    with explained("wrong magic or damaged", path), Image.open(path) as image:
        mode, bands, (width, height) = image.mode, image.getbands(), image.size
    bands = PALETTE if mode == "P" else bands
    dtype = np.dtype(TYPES.get(mode, "u1"))
    if bands == PALETTE and subset.channel is None:
        text = "a picture with a palette: the luminance of its colours is drawn"
        warn_of_data(text, where=str(path), allowed="channel: index for its indices, as of labels")
        subset = replace(subset, channel=0)
    slab = select((height, width, len(bands)), "YXC", subset, str(path), [NAMES.get(band, band) for band in bands])
    check_packed(size, slab.samples * dtype.itemsize, "TIFF", str(path))
    return PictureSource(f"{path}{slab.label}", Grid(slab.shape_zyx), dtype, path, slab)


SLICES: dict[str, Callable[[Path, Subset], Source]] = {
    **dict.fromkeys((".tif", ".tiff"), open_tiff),
    **dict.fromkeys(PICTURES, open_picture),
}


@dataclass(frozen=True)
class FolderSource:
    """Volume of slices, each opened when it is read."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    files: tuple[Path, ...]
    subset: Subset
    slab: Hyperslab | None

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        voxels = np.empty(check_box(begin_zyx, end_zyx, self.grid.shape_zyx), self.dtype)
        (z, y, x), (z_end, y_end, x_end) = begin_zyx, end_zyx
        for layer, file in zip(voxels, self.files[z:z_end], strict=True):
            opened = _open_slice(file, self.subset)
            found, wanted = (opened.grid.shape_zyx[1:], opened.dtype), (self.grid.shape_zyx[1:], self.dtype)
            if found != wanted:
                what, allowed = "not of one size and type with the first slice", _described(*wanted)
                raise DataError(what, where=str(file), found=_described(*found), allowed=allowed)
            layer[:] = opened.read((0, y, x), (1, y_end, x_end))[0]
        return voxels


def open_folder(path: Path, subset: Subset) -> Source:
    where = str(path)
    with readable(path):
        held = [file for file in path.iterdir() if not file.name.startswith(".")]
        files = [file for file in held if file.suffix.lower() in SLICES]
        dicom = [] if files else sorted(filter(is_dicom, held))
    if dicom:
        return open_series(dicom, subset, where)
    check_folder(path)
    kinds = Counter(file.suffix.lower() for file in files)
    if len(kinds) != 1:
        found = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        what = "a directory with slices of several kinds" if kinds else "a directory without slices"
        raise DataError(what, where=where, found=found or None, allowed=f"files of one kind: {' '.join(SLICES)} .dcm")
    files.sort(key=by_numbers)
    first = _open_slice(files[0], subset)
    _, y, x = first.grid.shape_zyx
    spacing = (*first.grid.spacing[:2], 1.0)
    grid = replace(first.grid, shape_zyx=(len(files), y, x), spacing=spacing)
    slab = getattr(first, "slab", None)
    if slab is not None and slab.channels > 1:  # the other slices have nothing to choose
        subset = replace(subset, channel=slab.channel)
    return FolderSource(where + (slab.label if slab else ""), grid, first.dtype, tuple(files), subset, slab)


def _open_slice(file: Path, subset: Subset) -> Source:
    opened = SLICES[file.suffix.lower()](file, subset)
    if opened.grid.shape_zyx[0] != 1:
        raise DataError("not a slice", where=str(file), found=f"{opened.grid.shape_zyx[0]} layers", allowed="one layer")
    return opened


def _described(shape: Index | tuple[int, ...], dtype: np.dtype[Any]) -> str:
    return f"{shape[-1]} x {shape[-2]} {dtype}"
