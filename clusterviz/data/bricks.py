"""Bricks: cubes of cells of a volume, with their overlap, and their reading.

A cell is the box between neighbouring samples, and belongs to one brick. A brick's samples are the corners of its
cells, so neighbouring bricks share one layer of samples, and linear interpolation inside a brick needs no other.
Gradients and cubic filters need a margin of further samples (ghosts) on every side.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index, Source, as_index

SLAB_BYTES = 64 << 20  # read at a time, in addition to the bricks being filled
Box = tuple[Index, Index]
Edges = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]


@dataclass(frozen=True)
class BrickLayout:
    """Division of a volume into bricks.

    Attributes
    ----------
    brick : cells a side, at least 1; the last brick along an axis may have fewer
    margin : samples beyond the corners of its cells that a brick is read with, on every side
    edges_zyx : where bricks are larger, multiples of `brick`: for each axis the borders between them, rising, in units
        of `brick` cells (thesis, section 5.3.6); None: bricks are uniform
    """

    shape_zyx: Index
    brick: int
    margin: int = 0
    edges_zyx: Edges | None = None

    @property
    def cells_zyx(self) -> Index:
        """Cells along each axis; a single sample counts as one cell without extent."""
        return as_index(max(1, n - 1) for n in self.shape_zyx)

    @property
    def counts_zyx(self) -> Index:
        if self.edges_zyx is None:  # without a list of the borders, of which there may be too many
            z, y, x = (-(-cells // self.brick) for cells in self.cells_zyx)
        else:
            z, y, x = (len(edges) + 1 for edges in self.edges_zyx)
        return z, y, x

    @cached_property
    def borders_zyx(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """The cells with which bricks begin along each axis, and the end of the last one."""
        inner = self.edges_zyx or [range(1, -(-cells // self.brick)) for cells in self.cells_zyx]
        z, y, x = (
            np.array([0, *(self.brick * edge for edge in edges), cells])
            for edges, cells in zip(inner, self.cells_zyx, strict=True)
        )
        return z, y, x

    @property
    def sides_zyx(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        z, y, x = map(np.diff, self.borders_zyx)
        return z, y, x

    def cell_box(self, index_zyx: Index) -> Box:
        z, y, x = index_zyx
        return self.cells_of(index_zyx, (z + 1, y + 1, x + 1))

    def cells_of(self, begin_zyx: Index, end_zyx: Index) -> Box:
        """The cells of a box of bricks; both half-open."""
        begin, end = ([int(b[i]) for b, i in zip(self.borders_zyx, at, strict=True)] for at in (begin_zyx, end_zyx))
        return as_index(begin), as_index(end)

    def unit_box(self, begin_zyx: Index, end_zyx: Index) -> Box:
        """The cubes of `brick` cells that a box of bricks consists of: bricks themselves, where these are uniform."""
        begin, end = self.cells_of(begin_zyx, end_zyx)
        return as_index(cell // self.brick for cell in begin), as_index(-(-cell // self.brick) for cell in end)

    def units(self, bricks: NDArray[np.int64]) -> NDArray[np.int64]:
        """The cubes of `brick` cells of bricks (n, 3), int64 (m, 3): those of the first brick before the second's."""
        if self.edges_zyx is None:
            return bricks
        boxes = [self.unit_box((z, y, x), (z + 1, y + 1, x + 1)) for z, y, x in bricks.tolist()]
        each = [np.argwhere(np.ones(np.subtract(end, begin), bool)) + begin for begin, end in boxes]
        return np.concatenate(each) if each else bricks

    def sample_box(self, index_zyx: Index) -> Box:
        """Return the brick's samples inside the volume, half-open: the corners of its cells and the margin."""
        begin, end = self.cell_box(index_zyx)
        low_z, low_y, low_x = (max(0, b - self.margin) for b in begin)
        z, y, x = (min(n, e + 1 + self.margin) for e, n in zip(end, self.shape_zyx, strict=True))
        return (low_z, low_y, low_x), (z, y, x)

    def owned_box(self, index_zyx: Index) -> Box:
        """Return the samples that only this brick owns, half-open; a shared layer belongs to the next brick."""
        begin, end = self.cell_box(index_zyx)
        z, y, x = (
            n if i == count - 1 else e
            for i, count, e, n in zip(index_zyx, self.counts_zyx, end, self.shape_zyx, strict=True)
        )
        return begin, (z, y, x)


class Boxes(Protocol):
    """Boxes of samples to read for each brick: a `BrickLayout`, or another division of the volume."""

    @property
    def margin(self) -> int: ...

    def cell_box(self, index_zyx: Index, /) -> Box: ...

    def sample_box(self, index_zyx: Index, /) -> Box: ...


def read_bricks(source: Source, layout: Boxes, wanted: Iterable[Index]) -> Iterator[tuple[Index, NDArray[Any]]]:
    """Read bricks with their overlap, in order of (z, y, x), so that a stream is read once.

    A layer of bricks is filled from slabs that span them all, which makes few large reads. In addition to the layer's
    bricks, at most `SLAB_BYTES` or one plane of samples is in memory.

    Yields
    ------
    index_zyx, samples : `source.dtype`, C order, owned by the caller: the samples of `layout.sample_box(index_zyx)`. A
        margin before the volume repeats the first samples, so that it has the same width in every brick.
    """
    for _, layer in groupby(sorted(set(wanted)), key=lambda index: index[0]):
        filled = _read_layer(source, {index: layout.sample_box(index) for index in layer})
        for index in list(filled):
            yield index, with_margin(layout, index, filled.pop(index))


def read_boxes(source: Source, boxes: Sequence[Box]) -> list[NDArray[Any]] | None:
    """Read the samples of several boxes; None if the source reads a single box at least as fast, by `Source.read`."""
    read = getattr(source, "read_boxes", None)
    return read(boxes) if read else None


def with_margin(layout: Boxes, index: Index, samples: NDArray[Any]) -> NDArray[Any]:
    """Return the samples, padded where the margin lies before the volume."""
    have = np.subtract(layout.cell_box(index)[0], layout.sample_box(index)[0])
    missing = [(int(layout.margin - before), 0) for before in have]
    return np.pad(samples, missing, mode="edge") if np.any(have < layout.margin) else samples


def _read_layer(source: Source, boxes: dict[Index, Box]) -> dict[Index, NDArray[Any]]:
    if (read := read_boxes(source, list(boxes.values()))) is not None:
        return dict(zip(boxes, read, strict=True))
    begins, ends = (np.array([box[side] for box in boxes.values()]) for side in (0, 1))
    (z_begin, y_begin, x_begin), (z_end, y_end, x_end) = begins.min(axis=0).tolist(), ends.max(axis=0).tolist()
    bricks = {index: np.empty(np.subtract(end, begin), source.dtype) for index, (begin, end) in boxes.items()}
    plane_bytes = (y_end - y_begin) * (x_end - x_begin) * source.dtype.itemsize
    planes = max(1, SLAB_BYTES // plane_bytes)
    for z in range(z_begin, z_end, planes):
        slab_end = min(z_end, z + planes)
        slab = source.read((z, y_begin, x_begin), (slab_end, y_end, x_end))
        for index, ((first, y, x), (last, y_stop, x_stop)) in boxes.items():
            # Boxes of other divisions may begin and end at different z.
            low, high = max(z, first), max(first, min(slab_end, last))
            part = slab[low - z : high - z, y - y_begin : y_stop - y_begin, x - x_begin : x_stop - x_begin]
            bricks[index][low - first : high - first] = part
    return bricks
