"""Blocks: division of an array into boxes of equal size, those of each rank, and what a box takes of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clusterviz.data.bricks import Box
from clusterviz.data.source import Index
from clusterviz.errors import InputError
from clusterviz.partition.bsp import build_tree
from clusterviz.partition.interleave import interleave
from clusterviz.partition.owners import Owners, owners_of

DISTRIBUTIONS = ("coherent", "interleaved")


@dataclass(frozen=True)
class Blocks:
    """Division of the elements of an array into blocks, which share none; the last along an axis may be smaller.

    It serves as `Boxes` of `data.bricks.read_bricks` too.

    Attributes
    ----------
    shape_zyx : elements along each axis, at least 1
    block_zyx : elements of a block along each axis, at least 1
    """

    shape_zyx: Index
    block_zyx: Index
    margin = 0

    @property
    def counts_zyx(self) -> Index:
        """Blocks along each axis."""
        z, y, x = (-(-n // side) for n, side in zip(self.shape_zyx, self.block_zyx, strict=True))
        return z, y, x

    @cached_property
    def sides_zyx(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Elements of the blocks along each axis."""
        z, y, x = (
            np.diff(np.append(np.arange(count) * side, n))
            for count, side, n in zip(self.counts_zyx, self.block_zyx, self.shape_zyx, strict=True)
        )
        return z, y, x

    @property
    def elements(self) -> NDArray[np.int64]:
        """Elements of each block, int64 (bz, by, bx)."""
        z, y, x = self.sides_zyx
        return z[:, None, None] * y[:, None] * x

    def box(self, index_zyx: Index, halo: int = 0) -> Box:
        """Return the elements of a block and those at most `halo` beyond it along each axis, cut at the array."""
        begin, end = [], []
        for i, side, n in zip(index_zyx, self.block_zyx, self.shape_zyx, strict=True):
            begin.append(max(0, i * side - halo))
            end.append(min(n, (i + 1) * side + halo))
        return (begin[0], begin[1], begin[2]), (end[0], end[1], end[2])

    cell_box = sample_box = box

    def parts(self, box: Box) -> list[list[tuple[int, int, int]]]:
        """Return along z, y and x: index, begin and end of what each block shares with a box."""
        return [
            [(i, max(begin, i * side), min(end, (i + 1) * side)) for i in range(begin // side, -(-end // side))]
            if begin < end
            else []
            for begin, end, side in zip(*box, self.block_zyx, strict=True)
        ]

    def shared(self, box: Box) -> Iterator[tuple[Index, Box]]:
        """Yield the blocks that share elements with a box, in array order, and those elements."""
        along_z, along_y, along_x = self.parts(box)
        for i, z, z_end in along_z:
            for j, y, y_end in along_y:
                for k, x, x_end in along_x:
                    yield (i, j, k), ((z, y, x), (z_end, y_end, x_end))


def make_blocks(shape_zyx: Index, block: int | Index, where: str) -> Blocks:
    """Return the division of an array into blocks of a side, or of sides along z, y and x.

    Raises
    ------
    InputError
        A side is no integer, or below 1.
    """
    sides = (block,) * 3 if isinstance(block, int | np.integer) else tuple(block)
    if len(sides) != 3 or not all(isinstance(side, int | np.integer) and side >= 1 for side in sides):
        raise InputError("no blocks", where=where, found=block, allowed="a side, or sides along z, y and x, from 1 on")
    z, y, x = (min(int(side), n) for side, n in zip(sides, shape_zyx, strict=True))
    return Blocks(shape_zyx, (z, y, x))


def block_owners(blocks: Blocks, ranks: int, distribution: str) -> Owners:
    """Return the owner of each block.

    Parameters
    ----------
    distribution : coherent: a box of blocks for each rank, by a BSP tree, so that halos seldom leave a rank;
        interleaved: neighbouring blocks on different ranks, so that work that differs between regions is shared

    Raises
    ------
    InputError
        No such distribution.
    """
    if distribution not in DISTRIBUTIONS:
        raise InputError("no such distribution", found=distribution, allowed=", ".join(DISTRIBUTIONS))
    cost = blocks.elements.astype(np.float64)
    return owners_of(build_tree(cost, ranks)) if distribution == "coherent" else interleave(cost, ranks)
