"""Layout of a brick of several volumes in GPU memory: a header, and then a slot for each volume.

The header has four words for each volume: the offset of its voxels in words from the header (−1: none), and its first
cell (x, y, z). Where volumes have levels, four more follow for each: the level, and the cells (x, y, z) that the brick
has of it. Groups of cells are those of the domain. Their visibility follows, for any transfer function, from the
extremes of each volume over the groups of voxels that meet the image of the group.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.plan.content import Content, ContentBrick, VolumeLayer
from clusterviz.plan.domain import Cut
from clusterviz.plan.plan import Plan
from clusterviz.render.storage import GROUP, GroupBox, Slot
from clusterviz.render.stored_brick import Part, Ranges, Stored, group_curvature, group_ranges

Words = NDArray[np.uint32]


def store_as(plan: Plan, slot: Slot) -> Callable[[Index, ContentBrick], Stored]:
    """Return the function that encodes a brick for a plan."""
    return lambda index, brick: store(brick, plan.content, slot.at(index))


def store(brick: ContentBrick, content: Content, slot: Slot) -> Stored:
    """Return a brick as it is stored in its slot."""
    index, bend = brick.index_zyx, None
    if slot.mixed:
        parts = [
            None if samples is None else Part.of(layer.encoding.encode(samples), layer.cut_of(index), index)
            for samples, layer in zip(brick.samples, content.volume_layers, strict=True)
        ]
    else:
        (samples,), (layer,) = brick.samples, content.volume_layers
        assert samples is not None, "a volume alone has samples in all of its bricks"
        parts = [Part(layer.encoding.encode(samples))]
        bend = group_curvature(samples, slot) if slot.adaptive else None
    return Stored(parts, *ranges_of(brick, content, slot), brick.size, bend, brick.members)


def pack_parts(parts: Sequence[Part | None], slot: Slot) -> NDArray[Any]:
    """Return the samples of a brick as its slot holds them, as of `Slot.pack`; the words of mixed content."""
    if not slot.mixed:
        return slot.pack(parts[0].samples)  # type: ignore[union-attr]
    words = np.zeros(slot.words, np.uint32)
    for row, begin, part, part_slot in zip(header_of(words, slot), _begins(slot), parts, slot.parts, strict=True):
        write_header(row, begin, part)
        if part is not None:
            words[begin : begin + part_slot.words] = part_slot.pack(part.samples).reshape(-1).view(np.uint32)
    return words


def parts_of(words: NDArray[Any], slot: Slot) -> list[Part | None]:
    """Return the parts of a brick, as many samples as its slot has, the inverse of `pack_parts`."""
    if not slot.mixed:
        return [Part(slot.unpack(words))]
    return [
        None if row[0] < 0 else read_header(row, part_slot.unpack(words[begin : begin + part_slot.words]), part_slot)
        for row, begin, part_slot in zip(header_of(words, slot), _begins(slot), slot.parts, strict=True)
    ]


def header_of(words: Words, slot: Slot) -> NDArray[np.int32]:
    """Return the header in a brick's words, a row for each volume."""
    return words[: slot.header_words * len(slot.parts)].view(np.int32).reshape(-1, slot.header_words)


def write_header(row: NDArray[np.int32], begin: int, part: Part | None) -> None:
    """Write the row of a volume, whose samples begin at a word."""
    row[:] = 0
    row[0] = -1
    if part is not None:
        row[:] = (begin, *part.first_xyz, part.level, *part.cells_xyz)[: len(row)]


def read_header(row: NDArray[np.int32], samples: NDArray[Any], slot: Slot) -> Part:
    """Return a volume's part of a brick; of its slot's samples, with levels, as many as the brick has."""
    _, x, y, z, *of_level = row.tolist()
    if not slot.has_levels:
        return Part(samples, (x, y, z))
    level, *cells = of_level
    part = Part(samples, (x, y, z), level, tuple(cells))
    return replace(part, samples=samples[tuple(map(slice, part.slot(slot).samples_zyx))])


def _begins(slot: Slot) -> list[int]:
    ends = accumulate((part_slot.words for part_slot in slot.parts), initial=slot.header_words * len(slot.parts))
    return list(ends)[:-1]


def ranges_of(brick: ContentBrick, content: Content, slot: Slot) -> Ranges:
    """Return the smallest and largest finite sample of each volume in each group of cells.

    Returns
    -------
    low, high : float64 (volumes, gz, gy, gx) of the groups that the brick has: of the domain (`GroupBox.of`), or of a
        volume alone its own; NaN where a volume has no samples
    """
    if slot.group_box is None:
        low, high = group_ranges(brick.samples[0], slot)  # type: ignore[arg-type]
        return low[None], high[None]
    groups = slot.group_box.shape_of(brick.index_zyx)
    found = np.full((len(slot.parts), 2, *groups), np.nan)
    for own, samples, layer, part in zip(found, brick.samples, content.volume_layers, slot.parts, strict=True):
        if samples is not None and own.size:
            _add_ranges(own, samples, layer, part, brick.index_zyx, slot.group_box)
    return found[:, 0], found[:, 1]


def _add_ranges(
    found: NDArray[Any], samples: NDArray[Any], volume_layer: VolumeLayer, part: Slot, index_zyx: Index, box: GroupBox
) -> None:
    cut = volume_layer.cut_of(index_zyx)
    # Groups of as many cells of the level as a group of the finest one spans.
    group = max(1, GROUP >> cut.level)
    of_level = replace(part, cells_zyx=cut.most_cells_zyx) if cut.level else part
    low, high = group_ranges(samples, of_level, group)
    begin, end = _groups_met(cut, index_zyx, box, group)
    met = (end > begin).all(axis=-1)
    # Few groups of voxels meet a group of cells along each axis.
    for offset in np.ndindex(*(end - begin).reshape(-1, 3).max(axis=0).clip(0).tolist()):
        there = tuple(np.moveaxis(np.minimum(begin + offset, end - 1), -1, 0))
        found[0] = np.where(met, np.fmin(found[0], low[there]), found[0])
        found[1] = np.where(met, np.fmax(found[1], high[there]), found[1])


def _groups_met(cut: Cut, index_zyx: Index, box: GroupBox, group: int) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Return half-open boxes (gz, gy, gx, 3), (z, y, x), of groups of voxels around the image of each group."""
    z, y, x = np.meshgrid(*map(np.arange, *box.of(index_zyx)), indexing="ij")
    first = np.array(index_zyx[::-1])
    begin = first * cut.layout.brick + np.ldexp(np.stack([x, y, z], axis=-1) - 1.0 * box.in_brick * first, box.shift)
    low, high = cut.images(begin, np.minimum(begin + (1 << box.shift), cut.extent))
    first = np.array(cut.cell_box(index_zyx)[0][::-1])
    last_group = np.array([-(-cells // group) - 1 for cells in cut.most_cells_zyx[::-1]])
    begins = np.clip(np.floor((low - cut.slack - first) / group), 0, last_group).astype(int)
    ends = np.clip(np.ceil((high + cut.slack - first) / group), begins + 1, last_group + 1).astype(int)
    met = cut.meets(low, high)[..., None]
    return begins[..., ::-1], np.where(met, ends, begins)[..., ::-1]
