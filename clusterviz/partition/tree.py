"""The partition as a value: a tree of planes between bricks, with one rank's share at each leaf."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

Index = tuple[int, int, int]


@dataclass(frozen=True)
class BrickBox:
    """The bricks [begin, end), counted along (z, y, x); empty where an end is not past its begin."""

    begin_zyx: Index
    end_zyx: Index

    @property
    def shape_zyx(self) -> Index:
        """Bricks along each axis, 0 where empty."""
        z, y, x = (max(0, end - begin) for begin, end in zip(self.begin_zyx, self.end_zyx, strict=True))
        return z, y, x

    @property
    def bricks(self) -> int:
        """Number of bricks."""
        z, y, x = self.shape_zyx
        return z * y * x

    @property
    def slices(self) -> tuple[slice, slice, slice]:
        """What cuts this box out of an array over all bricks."""
        z, y, x = (slice(begin, end) for begin, end in zip(self.begin_zyx, self.end_zyx, strict=True))
        return z, y, x


@dataclass(frozen=True)
class Leaf:
    """One rank's share.

    Attributes
    ----------
    rank : whose it is
    box : its bricks; the boxes of all leaves hold each brick exactly once
    trimmed : the bounding box of its bricks with a cost above 0; empty (all zero) if there are none
    cost : the sum over its bricks
    """

    rank: int
    box: BrickBox
    trimmed: BrickBox
    cost: float


@dataclass(frozen=True)
class Split:
    """A plane between bricks: `low` holds the bricks before `plane` along `axis_zyx`, `high` the others.

    Attributes
    ----------
    axis_zyx : 0 for z, 1 for y, 2 for x, as in array indices
    plane : index of the first brick behind the plane
    low, high : the two sides; low holds the lower ranks
    """

    axis_zyx: int
    plane: int
    low: Node
    high: Node


Node = Leaf | Split


@dataclass(frozen=True)
class BspTree:
    """The partition of a volume of `shape_zyx` bricks among `ranks` ranks."""

    shape_zyx: Index
    ranks: int
    root: Node

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """All leaves; the index is the rank."""
        return tuple(leaves_below(self.root))


def leaves_below(node: Node) -> Iterator[Leaf]:
    """The leaves of a node, by rank."""
    if isinstance(node, Leaf):
        yield node
    else:
        yield from leaves_below(node.low)
        yield from leaves_below(node.high)
