"""TIFF stacks (.tif, .tiff) of microscopy, one page a layer; tifffile reads the pages.

Spacing comes from OME metadata (PhysicalSizeX, Y, Z) or from ImageJ's (spacing, and resolution in pixels a unit), in
the unit of x. Without either, samples lie 1 apart. Uncompressed contiguous stacks are read box by box, others page by
page. Of a file with several series, `array` is the number of one. Axes T and C (or S, the samples of a pixel) are time
and channels. A series of pictures along T alone is a stack along z, unless a time is named.
"""

from __future__ import annotations

import logging
import os
import re
import struct
import weakref
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import tifffile
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, select
from clusterviz.data.files import explained, require_file
from clusterviz.data.header import axis_factors, check_box, check_dtype, check_packed, check_size, make_grid
from clusterviz.data.source import Grid, Index, Source, Triple
from clusterviz.data.storage import FileBytes, FileRange, slab_source
from clusterviz.errors import DataError

OME_UNIT = "µm"
"""Unit of sizes that name none."""
LOST_PAGES = re.compile("page offset|failed to reshape|circular")


@dataclass(frozen=True)
class TiffPages:
    """Stack of pages that are decoded when read; `file` stays open as long as the source lives."""

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    file: Any
    pages: Any
    slab: Hyperslab

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        voxels = np.empty(check_box(begin_zyx, end_zyx, self.grid.shape_zyx), self.dtype)
        shape, index = self.slab.shape, self.slab.index
        inside = next(axis for axis in range(len(shape) + 1) if prod(shape[:axis]) == len(self.pages))
        for layer, z in zip(voxels, range(begin_zyx[0], end_zyx[0]), strict=True):
            before = [z if i is None else i for i in index[:inside]]
            page = self._page(int(np.ravel_multi_index(before, shape[:inside])) if before else 0)
            picture = page.reshape(shape[inside:])[tuple(slice(None) if i is None else i for i in index[inside:])]
            picture = picture[z] if picture.ndim == 3 else picture
            layer[:] = picture[begin_zyx[1] : end_zyx[1], begin_zyx[2] : end_zyx[2]]
        return voxels

    def _page(self, number: int) -> NDArray[Any]:
        page = self.pages[number]
        where = f"{self.name}: page {number}"
        if page is None:
            raise DataError("the page is missing", where=where)
        _check_page(page, self.file.filehandle.size, where)
        with explained("the page cannot be decoded", where):
            return np.asarray(page.asarray())


def _check_page(page: Any, size: int, where: str) -> None:
    """Check that all strips or tiles of a page are there and can hold it."""
    ends = [b + n for b, n in zip(page.dataoffsets, page.databytecounts, strict=False)]
    check_size(size, max(ends, default=0), where)
    parts = int(np.prod(page.chunked, dtype=object))
    if len(page.dataoffsets) < parts:
        raise DataError("strips or tiles are missing", where=where, found=len(page.dataoffsets), allowed=parts)
    packed = min(size, sum(page.databytecounts))
    check_packed(packed, int(np.prod(page.shape, dtype=object)) * page.dtype.itemsize, "TIFF", where)


def _check_codec(page: Any, where: str) -> None:
    """Check that what decodes a page is installed: tifffile has few codecs of its own."""
    try:
        codec = tifffile.TIFF.DECOMPRESSORS[page.compression]
        tifffile.TIFF.UNPREDICTORS[page.predictor]
        if page.compression > 1:
            codec(b"")
    except (KeyError, ImportError) as error:
        found = f"{getattr(page.compression, 'name', page.compression)}, predictor {int(page.predictor)}"
        text = "needs the imagecodecs package"
        raise DataError(text, where=where, found=found, allowed="pip install imagecodecs") from error
    except Exception:  # no bytes are damaged ones
        return


def open_tiff(path: Path, subset: Subset) -> Source:
    size = require_file(path)
    with ExitStack() as closing:
        with explained("truncated or damaged", path), _lost_pages_raised():
            file: Any = closing.enter_context(tifffile.TiffFile(path))
            _check_pages(file, size)
            series, number = _choose(file.series, subset.array, path)
            shape, axes = tuple(int(n) for n in series.shape), str(series.axes)
            spacing, names = _spacing_of(file, path), _channel_names(file, series)
        where = f"{path}:{number}" if len(file.series) > 1 else str(path)
        stored = np.dtype(series.dtype).newbyteorder(file.byteorder)
        slab = select(shape, _letters(shape, axes, subset), subset, where, names)
        grid = replace(make_grid(slab.shape_zyx, np.diag(spacing), (0, 0, 0), where), modality="microscopy")
        name = where + slab.label
        dtype = check_dtype(stored, name)
        if series.dataoffset is None:
            _check_codec(series.keyframe, name)
            _check_page(series.keyframe, size, name)
            source = TiffPages(name, grid, dtype, file, series.pages, slab)
            weakref.finalize(source, closing.pop_all().close)
            return source
        check_size(size, series.dataoffset + slab.samples * stored.itemsize, name)
        storage = FileBytes([FileRange(path, int(series.dataoffset), slab.samples * stored.itemsize)])
        return slab_source(where, slab, grid, storage, stored)


def _check_pages(file: Any, size: int) -> None:
    """Check that the chain of pages has no loop, which tifffile would follow without end."""
    layout, handle, seen = file.tiff, file.filehandle, set()
    handle.seek(layout.offsetsize if layout.offsetsize == 8 else 4)
    while True:
        offset = struct.unpack(layout.offsetformat, handle.read(layout.offsetsize))[0]
        if not 0 < offset < size:
            return
        if offset in seen:
            raise ValueError("the chain of pages runs in a circle")
        seen.add(offset)
        handle.seek(offset)
        tags = struct.unpack(layout.tagnoformat, handle.read(layout.tagnosize))[0]
        handle.seek(tags * layout.tagsize, os.SEEK_CUR)


def _letters(shape: tuple[int, ...], axes: str, subset: Subset) -> str:
    """Return the letters of the axes for `select`: samples of a pixel are channels; time and channels are not space."""
    kept = "".join(axis if n > 1 or axis in "YX" else "Z" for axis, n in zip(axes, shape, strict=True))
    letters = kept.translate(str.maketrans("S", "C"))
    stacks = [axis for axis, n in zip(letters, shape, strict=True) if axis not in "TCYX" and n > 1]
    return letters if stacks or subset.time is not None else letters.replace("T", "Z")


def _channel_names(file: Any, series: Any) -> tuple[str, ...]:
    """Return the names of the channels: OME's, or the colours of pixels."""
    if file.is_ome and file.ome_metadata:
        pixels = _ome_pixels(file)
        channels = () if pixels is None else pixels.findall("{*}Channel")
        names = tuple(channel.attrib.get("Name", "") for channel in channels)
        return names if all(names) else ()
    if getattr(series.keyframe.photometric, "name", "") == "RGB":
        return ("red", "green", "blue", "alpha")[: series.keyframe.samplesperpixel]
    return ()


def _ome_pixels(file: Any) -> Any:
    return ElementTree.fromstring(file.ome_metadata).find(".//{*}Pixels")


@contextmanager
def _lost_pages_raised() -> Iterator[None]:
    """Context that raises lost pages, which tifffile only logs."""
    lost: list[str] = []

    def catch(record: logging.LogRecord) -> bool:
        if not LOST_PAGES.search(record.getMessage()):
            return True
        lost.append(record.getMessage())
        return False

    logger = logging.getLogger("tifffile")
    logger.addFilter(catch)
    try:
        yield
    finally:
        logger.removeFilter(catch)
    if lost:
        raise ValueError(lost[0])


def _choose(series: Any, array: str | None, path: Path) -> tuple[Any, int]:
    if array is not None and array not in map(str, range(len(series))):
        listed = ", ".join(f"{i}: {s.axes} {s.shape}" for i, s in enumerate(series))
        raise DataError("no such array", where=str(path), found=array, allowed=listed)
    return series[int(array or 0)], int(array or 0)


def _spacing_of(file: Any, path: Path) -> Triple:
    """Return the world units between samples along x, y, z, in the unit of x; 1 where the file has none."""
    if file.is_ome and file.ome_metadata:
        pixels = _ome_pixels(file)
        attributes = {} if pixels is None else pixels.attrib
        names = [f"PhysicalSize{axis}" for axis in "XYZ"]
        sizes = [_positive(attributes.get(name, 1)) for name in names]
        units = [attributes.get(f"{name}Unit", OME_UNIT) if name in attributes else "" for name in names]
    elif imagej := file.imagej_metadata:
        sizes = [_pixel_size(file.pages[0].tags.get(tag)) for tag in ("XResolution", "YResolution")]
        sizes.append(_positive(imagej.get("spacing", 1)))
        units = [str(imagej.get(key) or imagej.get("unit") or "") for key in ("unit", "yunit", "zunit")]
    else:
        return 1.0, 1.0, 1.0
    x, y, z = (size * factor for size, factor in zip(sizes, axis_factors(units, str(path)), strict=True))
    return x, y, z


def _pixel_size(resolution: Any) -> float:
    if resolution is None or 0 in resolution.value:
        return 1.0
    pixels, units = resolution.value
    return _positive(units / pixels)


def _positive(value: Any) -> float:
    try:
        number = abs(float(value))
    except (TypeError, ValueError):
        return 1.0
    return number if np.isfinite(number) and number > 0 else 1.0
