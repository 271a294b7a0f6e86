"""Visibility order for any assignment: the bricks in groups that can be drawn whole, one behind the other.

A tree of planes gives an order of ranks only while every rank holds a box. Interleaved and replicated bricks never do,
and bricks that move from rank to rank do not while they move. What holds for all of them: along a ray from the eye, the
brick's index along each axis only ever grows in distance from the eye's own. So a brick can be drawn as soon as all
between it and the eye, in that sense, are.
"""

from __future__ import annotations

import itertools
import math
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
    number, ranks = _grow_groups(small, owners.ranks, (z, y, x))
    return tuple(map(Group, ranks, _members(number[np.ix_(*keys)], len(ranks))))


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


def _grow_groups(owner: NDArray[np.int32], ranks: int, eye: Index) -> tuple[NDArray[np.int64], list[int]]:
    """The number of each brick's group, -1 where nobody draws, and the groups' ranks; whole ranks come first."""
    number = np.full(owner.shape, -1, np.int64)
    left = owner.copy()
    order: list[int] = []
    held = np.bincount(owner[owner != NOBODY], minlength=ranks)
    while held.any():
        clear = _unobstructed(left, ranks, eye)
        drawable = np.bincount(left[clear], minlength=ranks)
        # The whole ranks first, as in sorting a graph: that costs no group elsewhere. None of them obstructs another.
        whole = np.flatnonzero((drawable == held) & (held > 0))
        chosen = whole if whole.size else np.array([np.argmax(drawable)])
        group = np.full(ranks, -1)
        group[chosen] = len(order) + np.arange(chosen.size)
        members = clear & (group[left] >= 0)
        number[members] = group[left[members]]
        left[members] = NOBODY
        held[chosen] -= drawable[chosen]
        order += chosen.tolist()
    return number, order


def _unobstructed(owner: NDArray[np.int32], ranks: int, eye: Index) -> Bools:
    """Bricks that their rank can draw now: between them and the eye are none but its own."""
    lowest, highest = np.where(owner == NOBODY, ranks, owner), owner.copy()
    for axis, at in enumerate(eye):
        for side in (slice(at, None), slice(at, None, -1)):
            part = (*[slice(None)] * axis, side)
            np.minimum.accumulate(lowest[part], axis=axis, out=lowest[part])
            np.maximum.accumulate(highest[part], axis=axis, out=highest[part])
    clear: Bools = (lowest == highest) & (owner != NOBODY)
    return clear


def _members(number: NDArray[np.int64], groups: int) -> list[NDArray[np.int64]]:
    """The bricks (m, 3) of each group, in array order."""
    flat = number.ravel()
    ordered = np.argsort(flat, kind="stable")
    begins = np.searchsorted(flat[ordered], np.arange(groups + 1))
    bricks = np.stack(np.unravel_index(ordered, number.shape), axis=1)
    return [bricks[begin:end] for begin, end in itertools.pairwise(begins)]
