"""Layout of a brick of several volumes in GPU memory: a header, and then a slot for each volume.

The header has four words for each volume: the offset of its voxels in words from the header (−1: none), and its first
cell (x, y, z). Groups of cells are those of the domain. Their visibility follows, for any transfer function, from the
extremes of each volume over the groups of voxels that meet the image of the group.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.source import Index
from clusterviz.plan.content import Content, ContentBrick, VolumeLayer
from clusterviz.plan.domain import SLACK, Cut
from clusterviz.plan.plan import Plan
from clusterviz.render.storage import GROUP, HEADER_WORDS, Slot
from clusterviz.render.stored_brick import Ranges, Stored, group_ranges, store

Words = NDArray[np.uint32]


def store_as(plan: Plan, slot: Slot) -> Callable[[Index, Any], Stored]:
    """Return the function that encodes a brick for a plan: its samples (z, y, x), or its `ContentBrick`."""
    content, encoding = plan.content, plan.encoding
    if content is None:
        return lambda index, voxels: store(voxels, encoding, slot.at(index))
    return lambda _, portions: store_content(portions, content, slot)


def store_content(portions: ContentBrick, content: Content, slot: Slot) -> Stored:
    """Return a brick of several volumes as it is stored."""
    low, high = content_ranges(portions, content, slot)
    words = pack_content(portions, content, slot)
    return Stored(words, low, high, portions.size, primitives=portions.primitives, cells=portions.cells)


@dataclass(frozen=True, eq=False)
class Part:
    """Samples of one volume in a brick.

    Attributes
    ----------
    samples : (z, y, x), encoded by `Encoding.encode`, at most as many as its slot has
    first_xyz : cell of the volume at the first sample inside the slot's margin
    """

    samples: NDArray[Any]
    first_xyz: tuple[int, ...]


def pack_content(portions: ContentBrick, content: Content, slot: Slot) -> Words:
    """Return the words of a brick's slot, uint32 (slot.words,)."""
    parts = [
        None if samples is None else Part(of.encoding.encode(samples), of.cut.cell_box(portions.index_zyx)[0][::-1])
        for samples, of in zip(portions.samples, content.volume_layers, strict=True)
    ]
    return pack_parts(parts, slot)


def pack_parts(parts: Sequence[Part | None], slot: Slot) -> Words:
    """Return the words of a slot from the samples of each volume; None: no samples."""
    words = np.zeros(slot.words, np.uint32)
    header = _header(words, slot)
    for row, begin, part, part_slot in zip(header, _begins(slot), parts, slot.parts, strict=True):
        row[0] = -1
        if part is not None:
            row[0], row[1:] = begin, part.first_xyz
            words[begin : begin + part_slot.words] = part_slot.pack(part.samples).reshape(-1).view(np.uint32)
    return words


def parts_of(words: Words, slot: Slot) -> list[Part | None]:
    """Return the samples of each volume from a brick's words, as many as its slot has."""
    return [
        None if row[0] < 0 else Part(part_slot.unpack(words[begin : begin + part_slot.words]), tuple(row[1:].tolist()))
        for row, begin, part_slot in zip(_header(words, slot), _begins(slot), slot.parts, strict=True)
    ]


def _header(words: Words, slot: Slot) -> NDArray[np.int32]:
    return words[: HEADER_WORDS * len(slot.parts)].view(np.int32).reshape(-1, HEADER_WORDS)


def _begins(slot: Slot) -> list[int]:
    """Return the first words of the parts of a slot."""
    ends = accumulate((part_slot.words for part_slot in slot.parts), initial=HEADER_WORDS * len(slot.parts))
    return list(ends)[:-1]


def content_ranges(portions: ContentBrick, content: Content, slot: Slot) -> Ranges:
    """Return the smallest and largest finite sample of each volume in each of the domain's groups of cells.

    Returns
    -------
    low, high : float64 (volumes, *slot.groups_zyx); NaN where a volume has no samples
    """
    pairs = [
        _ranges_of_part(samples, volume_layer, part, portions.index_zyx, slot)
        for samples, volume_layer, part in zip(portions.samples, content.volume_layers, slot.parts, strict=True)
    ]
    found: NDArray[Any] = np.array(pairs).reshape(-1, 2, *slot.groups_zyx)
    return found[:, 0], found[:, 1]


def _ranges_of_part(
    samples: NDArray[Any] | None, volume_layer: VolumeLayer, part: Slot, index_zyx: tuple[int, int, int], slot: Slot
) -> Ranges:
    found = np.full((2, *slot.groups_zyx), np.nan)
    if samples is None:
        return found[0], found[1]
    low, high = (side.astype(np.float64) for side in group_ranges(samples, part))
    begin, end = _groups_met(volume_layer.cut, index_zyx, slot)
    met = (end > begin).all(axis=-1)
    # Few groups of voxels meet a group of cells along each axis.
    for offset in np.ndindex(*(end - begin).reshape(-1, 3).max(axis=0).clip(0).tolist()):
        there = tuple(np.moveaxis(np.minimum(begin + offset, end - 1), -1, 0))
        found[0] = np.where(met, np.fmin(found[0], low[there]), found[0])
        found[1] = np.where(met, np.fmax(found[1], high[there]), found[1])
    return found[0], found[1]


def _groups_met(cut: Cut, index_zyx: tuple[int, int, int], slot: Slot) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Return half-open boxes (gz, gy, gx, 3), (z, y, x), of groups of voxels around the image of each group."""
    z, y, x = np.meshgrid(*(np.arange(count) for count in slot.groups_zyx), indexing="ij")
    begin = np.array(index_zyx[::-1], np.float64) * cut.layout.brick + GROUP * np.stack([x, y, z], axis=-1)
    low, high = cut.images(begin, np.minimum(begin + GROUP, cut.extent))
    first = np.array(cut.cell_box(index_zyx)[0][::-1])
    last_group = np.array([-(-cells // GROUP) - 1 for cells in cut.most_cells_zyx[::-1]])
    groups = [
        np.clip(np.floor((side - first) / GROUP), 0, last_group).astype(int) for side in (low - SLACK, high + SLACK)
    ]
    met = cut.meets(low, high)[..., None]
    return groups[0][..., ::-1], np.where(met, groups[1] + 1, groups[0])[..., ::-1]
