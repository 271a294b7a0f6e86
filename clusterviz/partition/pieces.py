"""Pieces: the partial images of a frame from front to back, for any distribution.

Every rank lists the same pieces; each becomes one partial image of one rank. A slab is drawn by the piece that owns the
brick at its midpoint, in the pixels of its rectangle, so the picture does not depend on the pieces.

For any assignment, groups of bricks, each drawn as one image, are ordered from front to back. A BSP tree orders the
ranks only if the bricks of every rank form a box. Those of interleaved, replicated and migrating distributions do not.
For all of them, the distance of the brick index from the eye's brick grows monotonically along a ray on each axis. So a
brick can be drawn as soon as all bricks between it and the eye, in that sense, have been drawn.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clusterviz.image.partial import Rect
from clusterviz.partition.bsp import Costs, trim
from clusterviz.partition.owners import UNASSIGNED, Owners
from clusterviz.partition.tree import BrickBox, BspTree, Index, Vector, check_finite, front_to_back

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class BrickGroup:
    """Bricks of one partial image."""

    rank: int  # rank that draws it
    # int64 (m, 3), indices (z, y, x) in array order; no ray leaves them for another rank's and returns
    bricks: NDArray[np.int64]


def visible_groups(owners: Owners, eye_brick: Vector | None, direction_index: Vector) -> tuple[BrickGroup, ...]:
    """Return all assigned bricks in groups from front to back.

    Every assigned brick is in one of the groups; no ray visits a later group before an earlier one. If whole ranks
    can be ordered, as those of a tree can, there is one group per rank; else few, not always the fewest. A rank's
    images are its groups in this order; ranks may have none. Errors as of `front_to_back`.

    `owners`: rank of each brick; bricks that are `UNASSIGNED` are ignored. `eye_brick`, `direction_index`: as in
    `front_to_back`.

    Notes
    -----
    A ray's coordinates are monotone, so the order holds for perspective and parallel rays, from outside and inside. It
    is stricter than necessary: two bricks are ordered if one is farther from the eye along every axis, even if no ray
    meets both. Adjacent layers of bricks with the same owners are merged, so that trees take microseconds.
    """
    check_finite(eye_brick, direction_index)
    eye = _eye_layers(owners.owner.shape, eye_brick, direction_index)
    keys = [_merged_layers(owners.owner, axis, eye[axis]) for axis in range(3)]
    small = owners.owner[np.ix_(*[np.flatnonzero(np.diff(key, prepend=-1)) for key in keys])]
    z, y, x = (int(key[at]) for key, at in zip(keys, eye, strict=True))
    number, ranks = _grow_groups(small, owners.ranks, (z, y, x))
    return tuple(map(BrickGroup, ranks, _members(number[np.ix_(*keys)], len(ranks))))


def _eye_layers(shape: tuple[int, ...], eye: Vector | None, direction: Vector) -> Index:
    """Return the brick layer of the eye along each axis, clamped to the volume; an end layer for parallel rays."""

    def layer(axis: int) -> int:
        last, towards = shape[axis] - 1, direction[2 - axis]
        if eye is None:
            return 0 if towards >= 0 else last
        return min(max(math.floor(eye[2 - axis]), 0), last)

    return layer(0), layer(1), layer(2)


def _merged_layers(owner: NDArray[np.int32], axis: int, eye: int) -> NDArray[np.int64]:
    """Return a number for each layer across an axis; neighbours with the same owners share it, except the eye's."""
    layers = np.moveaxis(owner, axis, 0).reshape(owner.shape[axis], -1)
    differs = np.any(layers[1:] != layers[:-1], axis=1)
    for border in (eye - 1, eye):
        if 0 <= border < len(differs):
            differs[border] = True
    return np.concatenate([[0], np.cumsum(differs)])


def _grow_groups(owner: NDArray[np.int32], ranks: int, eye: Index) -> tuple[NDArray[np.int64], list[int]]:
    """Return the group of each brick (-1 if unassigned), and the rank of each group."""
    number = np.full(owner.shape, -1, np.int64)
    left = owner.copy()
    order: list[int] = []
    held = np.bincount(owner[owner != UNASSIGNED], minlength=ranks)
    while held.any():
        clear = _unobstructed(left, ranks, eye)
        drawable = np.bincount(left[clear], minlength=ranks)
        # Ranks that can be drawn as a whole first, as in a topological sort: none of them obstructs another.
        whole = np.flatnonzero((drawable == held) & (held > 0))
        chosen = whole if whole.size else np.array([np.argmax(drawable)])
        group = np.full(ranks, -1)
        group[chosen] = len(order) + np.arange(chosen.size)
        members = clear & (group[left] >= 0)
        number[members] = group[left[members]]
        left[members] = UNASSIGNED
        held[chosen] -= drawable[chosen]
        order += chosen.tolist()
    return number, order


def _unobstructed(owner: NDArray[np.int32], ranks: int, eye: Index) -> Bools:
    """Return the bricks that can be drawn now: between them and the eye are only bricks of their own rank."""
    lowest, highest = np.where(owner == UNASSIGNED, ranks, owner), owner.copy()
    for axis, at in enumerate(eye):
        for side in (slice(at, None), slice(at, None, -1)):
            part = (*[slice(None)] * axis, side)
            np.minimum.accumulate(lowest[part], axis=axis, out=lowest[part])
            np.maximum.accumulate(highest[part], axis=axis, out=highest[part])
    clear: Bools = (lowest == highest) & (owner != UNASSIGNED)
    return clear


def _members(number: NDArray[np.int64], groups: int) -> list[NDArray[np.int64]]:
    flat = number.ravel()
    ordered = np.argsort(flat, kind="stable")
    begins = np.searchsorted(flat[ordered], np.arange(groups + 1))
    bricks = np.stack(np.unravel_index(ordered, number.shape), axis=1)
    return [bricks[begin:end] for begin, end in itertools.pairwise(begins)]


@dataclass(frozen=True, eq=False)
class Piece:
    """Bricks and pixels of one partial image."""

    rank: int  # rank that draws it
    box: BrickBox  # bounding box of its bricks
    bricks: NDArray[np.bool_] | None = None  # bool (bz, by, bx) over the box, its own bricks; None: all
    rect: Rect | None = None  # pixels to which it is clipped; None: the whole picture

    def shows_bricks_of(self, other: Piece) -> bool:
        """Return whether another piece has the same bricks, as the pieces of a shared screen do."""
        return self.box == other.box and self.bricks is other.bricks

    def part(self, bricks: NDArray[np.int64]) -> Piece:
        """Return the piece of some of its bricks, int64 (m, 3), m at least 1."""
        return replace(self, **_around(bricks))

    def members(self, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return its bricks that are shown, int64 (m, 3), indices (z, y, x); `shown` is bool over all bricks."""
        inside = shown[self.box.slices]
        return np.argwhere(inside if self.bricks is None else inside & self.bricks) + self.box.begin_zyx


def leaf_pieces(tree: BspTree, cost: Costs, eye_brick: Vector | None, direction_index: Vector) -> tuple[Piece, ...]:
    """Return a piece for each leaf with a cost above 0, from front to back.

    `cost`: float64 (bz, by, bx); may differ from the costs from which the tree was built.
    """
    order = front_to_back(tree, eye_brick, direction_index)
    boxes = [(rank, trim(cost, tree.leaves[rank].box)) for rank in order]
    return tuple(Piece(rank, box) for rank, box in boxes if box.bricks)


def owner_pieces(owners: Owners, eye_brick: Vector | None, direction_index: Vector) -> tuple[Piece, ...]:
    """Return a piece for each of the `visible_groups` of any assignment, from front to back."""
    groups = visible_groups(owners, eye_brick, direction_index)
    return tuple(Piece(group.rank, **_around(group.bricks)) for group in groups)


def _around(bricks: NDArray[np.int64]) -> dict[str, Any]:
    """Return the fields `box` and `bricks` of a piece."""
    box = bounding_box(bricks)
    own = np.zeros(box.shape_zyx, bool)
    own[tuple((bricks - box.begin_zyx).T)] = True
    return {"box": box, "bricks": None if own.all() else own}


def bounding_box(bricks: NDArray[np.int64]) -> BrickBox:
    """Return the bounding box of bricks, int64 (m, 3), m at least 1."""
    (z, y, x), (z_last, y_last, x_last) = bricks.min(axis=0).tolist(), bricks.max(axis=0).tolist()
    return BrickBox((z, y, x), (z_last + 1, y_last + 1, x_last + 1))
