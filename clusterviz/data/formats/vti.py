"""VTK image and rectilinear files in XML (.vti, .vtr), as ParaView, PyVista and many simulations write them, and
those in pieces (.pvti, .pvtr); see `clusterviz.data.vtk_xml`.

Point data lies on the samples; cell data is point data at the cells' centres. Without a name the active scalars are
taken, or the only scalar array. Of files in pieces only the pieces are read that a box meets; where pieces overlap, the
first one counts that does not have the sample as a ghost. Uneven coordinates are those of
`clusterviz.data.rectilinear`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.axes import Hyperslab, Subset, select
from clusterviz.data.files import require_file
from clusterviz.data.header import check_box, check_packed, check_shape, stated_numbers
from clusterviz.data.source import Grid, Index, Source, as_index
from clusterviz.data.storage import StridedSource, slab_source
from clusterviz.data.vtk_image import VisibleSource, open_image, rectilinear, stated_grid
from clusterviz.data.vtk_xml import PACKINGS, XmlArray, XmlLayout, load_array, scan_xml, storage_of, stored_dtype
from clusterviz.errors import DataError

MAX_PIECES = 1 << 16


@dataclass(frozen=True)
class Piece:
    """Array of a file with one piece.

    Attributes
    ----------
    source : its samples, on a grid without a place
    extent : int64 (3, 2), first and last point along x, y, z
    whole : extent of the dataset
    coordinates : of the points along x, y and z, in a rectilinear file; else empty
    """

    source: StridedSource | VisibleSource
    array: str
    on_cells: bool
    extent: NDArray[np.int64]
    whole: NDArray[np.int64]
    coordinates: tuple[NDArray[Any], ...]
    layout: XmlLayout


@dataclass(frozen=True)
class PiecesSource:
    """Volume in pieces, which are opened when a box meets them.

    Attributes
    ----------
    boxes : int64 (n, 2, 3), first sample and end of each piece along z, y, x
    open_piece : function of a piece's number
    """

    name: str
    grid: Grid
    dtype: np.dtype[Any]
    boxes: NDArray[np.int64]
    open_piece: Callable[[int], StridedSource | VisibleSource]
    slab: Hyperslab

    def read(self, begin_zyx: Index, end_zyx: Index) -> NDArray[Any]:
        shape = check_box(begin_zyx, end_zyx, self.grid.shape_zyx)
        voxels, missing = np.empty(shape, self.dtype), np.ones(shape, bool)
        begins, ends = np.maximum(self.boxes[:, 0], begin_zyx), np.minimum(self.boxes[:, 1], end_zyx)
        # Ghost samples of a piece count only where no other piece has the sample as its own.
        for with_ghosts, number in product((False, True), np.flatnonzero((begins < ends).all(axis=1)).tolist()):
            begin, end = begins[number], ends[number]
            part = tuple(slice(b, e) for b, e in zip(begin - begin_zyx, end - begin_zyx, strict=True))
            if not missing[part].any():
                continue
            first, source, wanted = self.boxes[number, 0], self.open_piece(number), missing[part].copy()
            box = _index(begin - first), _index(end - first)
            for ghosts in () if with_ghosts else getattr(source, "duplicates", ()):
                wanted &= ~ghosts.read(*box)
            np.copyto(voxels[part], source.read(*box), where=wanted)
            missing[part] &= ~wanted
        if missing.any():
            found = f"{np.count_nonzero(missing)} samples in no piece"
            raise DataError("the pieces leave gaps", where=self.name, found=found)
        return voxels


def _index(numbers: NDArray[np.int64]) -> Index:
    return as_index(numbers.tolist())


def open_vti(path: Path, subset: Subset) -> Source:
    piece = _open_piece(path, subset, _kind(path))
    if (piece.extent != piece.whole).any():
        found, allowed = piece.extent.tolist(), piece.whole.tolist()
        raise DataError("unsupported: the piece is not the whole", where=str(path), found=found, allowed=allowed)
    return _placed(piece.source, piece.layout.dataset, piece.whole, piece.on_cells, piece.coordinates, subset.spaced)


def open_pvti(path: Path, subset: Subset) -> Source:
    where, kind = str(path), _kind(path)
    layout = scan_xml(path, f"P{kind}")
    whole = _extent(layout.dataset, "WholeExtent", where)
    pieces = [(_extent(piece, "Extent", where), path.parent / piece.get("Source", "")) for piece in layout.pieces]
    # Ranks of a program that have no points write an extent that ends before it begins.
    filled = [(extent, file) for extent, file in pieces if (extent[:, 0] <= extent[:, 1]).all()]
    if not 0 < len(filled) <= MAX_PIECES:
        raise DataError("no pieces", where=where, found=len(filled), allowed=f"1 to {MAX_PIECES}")
    extents, files = zip(*filled, strict=True)
    first = _open_piece(files[0], subset, kind)

    def opened(number: int) -> Piece:
        piece = _open_piece(files[number], replace(subset, array=first.array), kind)
        found = piece.source.dtype.name, piece.on_cells, piece.extent.tolist()
        allowed = first.source.dtype.name, first.on_cells, extents[number].tolist()
        if found != allowed:
            raise DataError("the piece does not fit", where=str(files[number]), found=found, allowed=allowed)
        return piece

    begins = np.stack([extent[::-1, 0] - whole[::-1, 0] for extent in extents])
    boxes = np.stack([begins, begins + [_samples(extent, first.on_cells, where) for extent in extents]], axis=1)
    shape = _samples(whole, first.on_cells, where)
    packing = PACKINGS.get(first.layout.file.get("compressor", ""), "text")
    assert first.source.slab, "the piece is a part of an array"
    slab = replace(first.source.slab, shape=(*shape, first.source.slab.channels), shape_zyx=shape)
    check_packed(sum(map(require_file, files)), slab.samples * first.source.stored_dtype.itemsize, packing, where)
    coordinates = tuple(
        np.full(last - begin + 1, np.nan, np.result_type(line, np.float32))
        for (begin, last), line in zip(whole.tolist(), first.coordinates, strict=False)  # an image has none
    )
    for number in range(len(files)) if coordinates else ():
        for line, part, begin in zip(
            coordinates, opened(number).coordinates, begins[number, ::-1].tolist(), strict=True
        ):
            line[max(0, begin) : begin + len(part)] = part[max(0, -begin) : len(line) - begin]
    name = (f"{where}:{first.array}" if len(first.layout.arrays) > 1 else where) + slab.label
    source = PiecesSource(name, Grid(shape), first.source.dtype, boxes, lru_cache(64)(lambda n: opened(n).source), slab)
    image = {**first.layout.dataset, **layout.dataset}  # VTK writes the direction into the pieces only
    return _placed(source, image, whole, first.on_cells, coordinates, subset.spaced)


def _kind(path: Path) -> str:
    return "RectilinearGrid" if path.suffix.lower().endswith("vtr") else "ImageData"


def _open_piece(path: Path, subset: Subset, kind: str) -> Piece:
    size, where, layout = require_file(path), str(path), scan_xml(path, kind)
    if len(layout.pieces) != 1:
        raise DataError("unsupported", where=where, found=f"{len(layout.pieces)} pieces", allowed="one piece")
    image, piece = layout.dataset, layout.pieces[0]
    extent = _extent(piece if "Extent" in piece else image, "Extent" if "Extent" in piece else "WholeExtent", where)
    whole = _extent(image, "WholeExtent", where) if "WholeExtent" in image else extent

    def source_of(array: XmlArray, subset: Subset) -> StridedSource:
        where = f"{path}:{array.name}"
        stored, shape = stored_dtype(layout, array, where), _samples(extent, array.on_cells, where)
        slab = select((*shape, array.components), "ZYXC", replace(subset, array=None), where)
        storage, begin = storage_of(path, size, layout, array, stored, slab.samples, where)
        return slab_source(where, slab, Grid(shape), storage, stored, begin)

    fitting = [a for a in layout.arrays if "Data" in a.section and a.components in ((1, 3) if subset.vectors else (1,))]
    chosen, source = open_image(fitting, subset, path, "scalar array", source_of)
    coordinates: tuple[NDArray[Any], ...] = ()
    if kind == "RectilinearGrid":
        arrays = [a for a in layout.arrays if a.section == "Coordinates"]
        if len(arrays) != 3:
            raise DataError("no coordinates", where=where, found=len(arrays), allowed="Coordinates of three arrays")
        counts = (extent[:, 1] - extent[:, 0] + 1).tolist()
        coordinates = tuple(load_array(path, size, layout, a, n) for a, n in zip(arrays, counts, strict=True))
    return Piece(source, chosen.name, chosen.on_cells, extent, whole, coordinates, layout)


def _extent(attributes: Mapping[str, str], key: str, where: str) -> NDArray[np.int64]:
    return stated_numbers(attributes.get(key, ""), key, 6, where).astype(np.int64).reshape(3, 2)


def _samples(extent: NDArray[np.int64], on_cells: bool, where: str) -> Index:
    points = extent[:, 1] - extent[:, 0] + 1
    return check_shape((np.where(points > 1, points - 1, points) if on_cells else points)[::-1].tolist(), where)


def _placed(
    source: Any,
    image: Mapping[str, str],
    extent: NDArray[np.int64],
    on_cells: bool,
    coordinates: tuple[NDArray[Any], ...],
    spaced: bool,
) -> Source:
    """Return the volume on its grid; the origin of an image belongs to index 0, and the extent may begin elsewhere."""
    where = source.name
    if coordinates:
        return rectilinear(source, coordinates, on_cells, spaced, where)
    found: Source = replace(source, grid=stated_grid(image, extent, on_cells, where))
    return found
