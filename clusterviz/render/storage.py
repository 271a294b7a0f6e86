"""Layout of a brick in GPU memory: the words of its slot, equal for every brick of a volume.

Buffers, not textures, hold voxels for the exact filters: a software renderer reads them at half the cost, and no limit
of 3-D textures applies. 8-bit voxels are stored four to a word with one repeated, so that a cell needs four fetches,
not eight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import Box, BrickLayout
from clusterviz.plan.content import Content, VolumeLayer
from clusterviz.plan.domain import SLACK
from clusterviz.plan.encoding import VoxelKind
from clusterviz.plan.plan import Plan

Index = tuple[int, int, int]
HEADER_WORDS = 4  # for each volume, in front of the parts of a brick of several volumes; as in volume_layer.glsl
LEVEL_WORDS = 4  # more of them, if a volume has levels; as in levels.glsl
GROUP = 8  # cells along the side of a group
MOST_GROUPS = 1 << 23  # of a domain; each takes 4 bytes
STORED_TYPE: dict[VoxelKind, str] = {"u8": "u1", "u16": "<u2", "f32": "<f4"}
TEXEL_SCALE: dict[VoxelKind, float] = {"u8": 255.0, "u16": 65535.0, "f32": 1.0}


@dataclass(frozen=True)
class GroupBox:
    """Groups of cells of a domain with several volumes or with geometry, in a box around all volumes.

    What is known of groups takes memory where volumes are, however large the domain and its bricks. Groups are counted
    brick by brick along each axis, and may be cut by the bricks' ends.

    Attributes
    ----------
    begin_zyx, end_zyx : groups, half-open; equal without volumes
    shift : a group has 1 << shift cells along its side
    brick : cells along the side of a brick
    """

    begin_zyx: Index
    end_zyx: Index
    shift: int
    brick: int

    @property
    def in_brick(self) -> int:
        """Groups along the side of a brick."""
        return -(-self.brick >> self.shift)

    def of(self, index_zyx: Index) -> Box:
        """Return the groups of the box that a brick has, half-open."""
        low, high = (np.array(side) for side in (self.begin_zyx, self.end_zyx))
        first = self.in_brick * np.array(index_zyx, np.int64)
        (z, y, x), (z_end, y_end, x_end) = np.clip([first, first + self.in_brick], low, high).tolist()
        return (z, y, x), (z_end, y_end, x_end)

    def shape_of(self, index_zyx: Index) -> Index:
        """Return the number of these along each axis; zeros if there are none."""
        z, y, x = (end - begin for begin, end in zip(*self.of(index_zyx), strict=True))
        return (z, y, x) if min(z, y, x) else (0, 0, 0)


@dataclass(frozen=True)
class Slot:
    """Memory layout of one brick.

    Attributes
    ----------
    cells_zyx : cells along each axis, one less than samples
    kind : the stored voxel type
    textured : stored as texels for the texture unit's filter, not as packed words
    margin : samples beyond the cells' corners, on every side
    reach : cells beyond its own in which the brick samples the field
    spread : samples beyond a cell's corners on which its pixels depend
    parts : slots of several volumes, one after the other behind a header; it has then no cells of its own
    mixed : a brick of the domain of several volumes, which with geometry may be one or none
    has_levels : of one of several volumes: a brick may hold samples of a coarser level, and then has fewer cells
    group_box : groups of cells of a brick of several volumes
    adaptive : slabs may be longer in some groups of its cells
    layout : layout with bricks of several sizes, of which this is the largest slot; None: all bricks have this slot
    """

    cells_zyx: Index
    kind: VoxelKind
    textured: bool
    margin: int = 0
    reach: int = 0
    spread: int = 0
    parts: tuple[Slot, ...] = ()
    adaptive: bool = False
    layout: BrickLayout | None = None
    mixed: bool = False
    has_levels: bool = False
    group_box: GroupBox | None = None

    def at(self, index_zyx: Index) -> Slot:
        """Return the slot of a brick."""
        if self.layout is None:
            return self
        z, y, x = (int(sides[i]) for sides, i in zip(self.layout.sides_zyx, index_zyx, strict=True))
        return replace(self, cells_zyx=(z, y, x), layout=None)

    @property
    def unit(self) -> Slot:
        """Return the slot of the cubes of cells that rays traverse, if bricks have several sizes."""
        if self.layout is None:
            return self
        z, y, x = (min(self.layout.brick, cells) for cells in self.layout.cells_zyx)
        return replace(self, cells_zyx=(z, y, x), layout=None)

    def counted(self, counts_zyx: Index, measure: Callable[[Slot], int]) -> NDArray[np.int64]:
        """Return a measure of the slots of all bricks, int64 (bz, by, bx)."""
        if self.layout is None:
            return np.full(counts_zyx, measure(self), np.int64)
        (zs, z), (ys, y), (xs, x) = (np.unique(sides, return_inverse=True) for sides in self.layout.sides_zyx)
        sizes = [(int(a), int(b), int(c)) for a in zs for b in ys for c in xs]
        found = [measure(replace(self, cells_zyx=size, layout=None)) for size in sizes]
        return np.array(found, np.int64).reshape(len(zs), len(ys), len(xs))[np.ix_(z, y, x)]

    @property
    def samples_zyx(self) -> Index:
        """Samples along each axis."""
        z, y, x = (cells + 1 + 2 * self.margin for cells in self.cells_zyx)
        return z, y, x

    @property
    def row_words(self) -> int:
        """4-byte words in a row of samples."""
        cells = self.samples_zyx[2] - 1
        return {"u8": -(-cells // 3), "u16": cells // 2 + 1, "f32": cells + 1}[self.kind]

    @property
    def slice_words(self) -> int:
        """Words in a (y, x) slice."""
        return self.row_words * self.samples_zyx[1]

    @property
    def words(self) -> int:
        """Words in the slot."""
        if self.mixed:
            return max(1, sum(self.header_words + part.words for part in self.parts))
        return self.slice_words * self.samples_zyx[0]

    @property
    def header_words(self) -> int:
        """Words for each volume in front of the parts of a brick of several volumes."""
        return HEADER_WORDS + LEVEL_WORDS * any(part.has_levels for part in self.parts)

    @property
    def bytes(self) -> int:
        """Bytes of GPU memory of a brick."""
        return self.sample_bytes if self.textured else 4 * self.words

    @property
    def sample_bytes(self) -> int:
        """Bytes of a brick's samples as ranks send them; those of the slot with several volumes."""
        if self.mixed:
            return self.bytes
        return int(np.prod(self.samples_zyx)) * {"u8": 1, "u16": 2, "f32": 4}[self.kind]

    @property
    def groups_zyx(self) -> Index:
        """Groups of cells that are skipped as one, along each axis."""
        z, y, x = (-(-cells // GROUP) for cells in self.cells_zyx)
        return z, y, x

    @property
    def visibility_words(self) -> int:
        """Words that hold one bit for each group."""
        return -(-int(np.prod(self.groups_zyx)) // 32)

    @property
    def group_words(self) -> int:
        """Words of a brick's groups: their visibility, and the lengths of their slabs."""
        return self.visibility_words * (3 if self.adaptive else 1)

    @property
    def texel_scale(self) -> float:
        """Factor that undoes the texture unit's normalisation of integers to 0 … 1."""
        return TEXEL_SCALE[self.kind] if self.textured else 1.0

    def pack(self, stored: NDArray[Any]) -> NDArray[Any]:
        """Return a brick's samples (z, y, x), encoded by `Encoding.encode`, as the slot stores them; C order.

        The last samples of a brick that is smaller than the slot are repeated.
        """
        z, y, x = self.samples_zyx
        row = x if self.textured else {"u8": 3 * self.row_words + 1, "u16": 2 * self.row_words, "f32": x}[self.kind]
        missing = [(0, n - have) for n, have in zip((z, y, row), stored.shape, strict=True)]
        stored = np.ascontiguousarray(
            np.pad(stored, missing, mode="edge") if any(m != (0, 0) for m in missing) else stored
        )
        if self.textured or self.kind == "f32":
            return stored
        if self.kind == "u16":
            return stored.view("<u4")
        # Words begin at every third byte, so they overlap by one voxel.
        words = np.ndarray((z, y, self.row_words), "<u4", stored, 0, (y * row, row, 3))
        return np.ascontiguousarray(words)

    def unpack(self, words: NDArray[Any]) -> NDArray[Any]:
        """Return all samples of a slot (z, y, x), the inverse of `pack`."""
        z, y, x = self.samples_zyx
        if self.textured or self.kind == "f32":
            return words.view(STORED_TYPE[self.kind]).reshape(z, y, x)
        if self.kind == "u16":
            return words.view("<u2").reshape(z, y, -1)[..., :x]
        voxels = words.view(np.uint8).reshape(z, y, self.row_words, 4)
        # The fourth voxel of each word but the last is the first of the next word.
        return np.concatenate([voxels[..., :3].reshape(z, y, -1), voxels[..., -1, 3:]], axis=2)[..., :x]


def slot_of(plan: Plan) -> Slot:
    """Return the slot of a plan's bricks, with a part for each volume of mixed content."""
    content = plan.content
    if content.mixed:
        parts = (
            # The cells include the reach; it is stored so that slots of different reach differ.
            replace(_slot(part.cut.at(part.finest).most_cells_zyx, part), has_levels=part.levels is not None)
            for part in content.volume_layers
        )
        return Slot((1, 1, 1), "f32", False, parts=tuple(parts), mixed=True, group_box=group_box_of(content))
    z, y, x = (int(sides.max()) for sides in plan.layout.sides_zyx)
    return replace(
        _slot((z, y, x), plan.volume),
        adaptive=plan.march.adaptive_step is not None,
        layout=None if plan.layout.edges_zyx is None else plan.layout,
    )


def _slot(cells_zyx: Index, volume: VolumeLayer) -> Slot:
    """Return the slot of a volume's bricks of at most so many cells."""
    kind, textured = volume.encoding.kind, "hardware" in volume.filter
    return Slot(cells_zyx, kind, textured, volume.cut.margin, volume.reach, volume.spread)


def group_box_of(content: Content) -> GroupBox:
    """Return the groups of cells around all volumes; larger than `GROUP` cells where there would be too many."""
    layout, low, high = content.layout, np.full(3, np.inf), np.full(3, -np.inf)
    for cut in (part.cut for part in content.volume_layers if min(part.cut.shape_zyx) > 1):
        matrix, offset = cut.index_from_domain[:, :3], cut.index_from_domain[:, 3]
        ends = np.array([np.full(3, -SLACK), np.array(cut.shape_zyx[::-1]) - 1 + SLACK])
        corners = np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3)
        cells = np.linalg.solve(matrix, (corners - offset).T).T
        low, high = np.minimum(low, cells.min(axis=0) - cut.reach), np.maximum(high, cells.max(axis=0) + cut.reach)
    shift = GROUP.bit_length() - 1
    if (low > high).any():
        return GroupBox((0, 0, 0), (0, 0, 0), shift, layout.brick)
    last = np.array(layout.cells_zyx[::-1]) - 1
    first, end = (np.clip(np.floor(side), 0, last).astype(np.int64) for side in (low, high))
    while np.prod((end >> shift) - (first >> shift) + 1.0) > MOST_GROUPS:
        shift += 1
    in_brick, brick = -(-layout.brick >> shift), layout.brick
    (x, y, z), (x_end, y_end, z_end) = (
        (cell // brick * in_brick + (cell % brick >> shift) + more).tolist() for cell, more in ((first, 0), (end, 1))
    )
    return GroupBox((z, y, x), (z_end, y_end, x_end), shift, brick)
