"""Visibility order for any assignment: the bricks in groups that can be drawn whole, one behind the other.

A tree of planes gives an order of ranks only while every rank holds a box. Interleaved and replicated bricks never do,
and bricks that move from rank to rank do not while they move. What holds for all of them: along a ray from the eye, the
brick's index along each axis only ever grows in distance from the eye's own. So a brick can be drawn as soon as all
between it and the eye, in that sense, are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clusterviz.errors import InputError
from clusterviz.partition.order import Vector
from clusterviz.partition.owners import NOBODY, Owners
from clusterviz.partition.tree import Index

Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Group:
    """One partial image.

    Attributes
    ----------
    rank : who draws it
    bricks : int64 (m, 3), indices (z, y, x) in array order; no ray leaves them for another rank's and comes back
    """

    rank: int
    bricks: NDArray[np.int64]


def visible_groups(
    owners: Owners, eye_index: Vector | None, direction_index: Vector, brick_cells: int
) -> tuple[Group, ...]:
    """All bricks that somebody draws, in groups from front to back.

    Parameters
    ----------
    owners : who draws what; bricks of `NOBODY` are passed through
    eye_index, direction_index, brick_cells : as of `front_to_back`

    Returns
    -------
    groups : every drawn brick in one of them; no ray visits a later group before an earlier one. Where whole ranks can
        be ordered, as those of a tree can, a group a rank; else few, not always the fewest. `order_of` makes of them
        what a compositor asks for; a rank's images are its groups in this order, and ranks may have none.

    Raises
    ------
    InputError
        A position or direction is not finite, or the brick has no cells.

    Notes
    -----
    A ray's coordinates are monotone, so the order holds for perspective and parallel rays, from outside and inside. It
    asks more than each single ray does: two bricks that no ray meets both count as ordered too where one is farther
    from the eye along every axis. Layers of bricks with the same owners are one layer here, so trees cost microseconds.
    """
    if not all(map(math.isfinite, (*direction_index, *(eye_index or ())))):
        raise InputError("not finite", where="camera", found=f"eye {eye_index}, direction {direction_index}")
    if brick_cells < 1:
        raise InputError("has no cells", where="brick", found=brick_cells, allowed="1 or more")
    eye = _eye_brick(owners.owner.shape, eye_index, direction_index, brick_cells)
    keys = [_merged_layers(owners.owner, axis, eye[axis]) for axis in range(3)]
    small = owners.owner[np.ix_(*[np.flatnonzero(np.diff(key, prepend=-1)) for key in keys])]
    z, y, x = (int(key[at]) for key, at in zip(keys, eye, strict=True))
    number = np.full(small.shape, -1, np.int64)
    ranks: list[int] = []
    for rank, members in _grow_groups(small, owners.ranks, (z, y, x)):
        number[members] = len(ranks)
        ranks.append(rank)
    whole = number[np.ix_(*keys)]
    return tuple(Group(rank, np.argwhere(whole == index)) for index, rank in enumerate(ranks))


def order_of(groups: tuple[Group, ...]) -> list[int]:
    """The ranks of the images from front to back, one entry an image."""
    return [group.rank for group in groups]


def _eye_brick(shape: tuple[int, ...], eye: Vector | None, direction: Vector, brick_cells: int) -> Index:
    """The brick layer along each axis from which rays only move away; parallel rays come in at an end."""

    def layer(axis: int) -> int:
        last, towards = shape[axis] - 1, direction[2 - axis]
        if eye is None:
            return 0 if towards >= 0 else last
        return min(max(math.floor(eye[2 - axis] / brick_cells), 0), last)

    return layer(0), layer(1), layer(2)


def _merged_layers(owner: NDArray[np.int32], axis: int, eye: int) -> NDArray[np.int64]:
    """A number for each layer across an axis: neighbours with the same owners share it, but for the eye's own."""
    layers = np.moveaxis(owner, axis, 0).reshape(owner.shape[axis], -1)
    differs = np.any(layers[1:] != layers[:-1], axis=1)
    for border in (eye - 1, eye):
        if 0 <= border < len(differs):
            differs[border] = True
    return np.concatenate([[0], np.cumsum(differs)])


def _grow_groups(owner: NDArray[np.int32], ranks: int, eye: Index) -> Iterator[tuple[int, Bools]]:
    """Rank after rank, with all that it can draw now; first those that can draw all that they have."""
    present = [rank for rank in range(ranks) if np.any(owner == rank)]
    foreign = np.stack([(owner != rank) & (owner != NOBODY) for rank in present] or [np.zeros(owner.shape, bool)])
    mine = np.stack([owner == rank for rank in present] or [np.zeros(owner.shape, bool)])
    done = np.zeros(owner.shape, bool)
    left = mine.sum(axis=(1, 2, 3))
    while left.any():
        clear = ~_shadows(foreign & ~done, eye)
        drawable = (clear & mine & ~done).sum(axis=(1, 2, 3))
        # The whole ranks first, as in sorting a graph: that costs no group elsewhere.
        best = int(np.argmax(np.where((drawable == left) & (left > 0), owner.size + 1, drawable)))
        members = clear[best] & mine[best] & ~done
        done |= members
        left[best] -= drawable[best]
        yield present[best], members


def _shadows(blocked: Bools, eye: Index) -> Bools:
    """What lies behind a blocked brick as seen from the eye, or is one: (n, bz, by, bx) for n at once."""
    shadow = blocked.copy()
    for axis, at in enumerate(eye, start=1):
        ahead, behind = [slice(None)] * 4, [slice(None)] * 4
        ahead[axis], behind[axis] = slice(at, None), slice(at, None, -1)
        for side in (tuple(ahead), tuple(behind)):
            shadow[side] = np.logical_or.accumulate(shadow[side], axis=axis)
    return shadow
