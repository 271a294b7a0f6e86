"""BSP trees over bricks: planes between bricks at the nodes, the bricks of one rank at each leaf."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

Index = tuple[int, int, int]


@dataclass(frozen=True)
class BrickBox:
    """The bricks [begin, end), indices along (z, y, x); empty if an end is not past its begin."""

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
        """Slices of this box in an array over all bricks."""
        z, y, x = (slice(begin, end) for begin, end in zip(self.begin_zyx, self.end_zyx, strict=True))
        return z, y, x


@dataclass(frozen=True)
class Leaf:
    """Leaf of a tree: the bricks of one rank.

    Attributes
    ----------
    rank : rank of the leaf
    box : its bricks; the boxes of all leaves contain each brick exactly once
    trimmed : bounding box of its bricks with a cost above 0; empty (all zero) if there are none
    cost : sum of its bricks' costs
    """

    rank: int
    box: BrickBox
    trimmed: BrickBox
    cost: float


@dataclass(frozen=True)
class Split:
    """Inner node: a plane between bricks; `low` has the bricks before `plane` along `axis_zyx`, `high` the others.

    Attributes
    ----------
    axis_zyx : 0 for z, 1 for y, 2 for x, as in array indices
    plane : index of the first brick behind the plane
    low, high : the two sides; low has the lower ranks
    """

    axis_zyx: int
    plane: int
    low: Node
    high: Node


Node = Leaf | Split


@dataclass(frozen=True)
class BspTree:
    """BSP tree of a volume of `shape_zyx` bricks with `ranks` leaves."""

    shape_zyx: Index
    ranks: int
    root: Node

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """All leaves; the index is the rank."""
        return tuple(leaves_below(self.root))


def leaves_below(node: Node) -> Iterator[Leaf]:
    """Return the leaves of a node, by rank."""
    if isinstance(node, Leaf):
        yield node
    else:
        yield from leaves_below(node.low)
        yield from leaves_below(node.high)


def draw(tree: BspTree) -> str:
    """Return a tree as text, with a line for each node.

    Returns
    -------
    text : for two ranks over 2 × 1 × 1 bricks of cost 1::

        2 × 1 × 1 bricks (z, y, x) on 2 ranks
        └─ z = 1
           ├─ rank 0: z 0…1, y 0…1, x 0…1, cost 1
           └─ rank 1: z 1…2, y 0…1, x 0…1, cost 1
    """
    z, y, x = tree.shape_zyx
    ranks = "1 rank" if tree.ranks == 1 else f"{tree.ranks} ranks"
    return "\n".join([f"{z} × {y} × {x} bricks (z, y, x) on {ranks}", *_lines(tree.root, "", last=True)])


def _lines(node: Node, margin: str, *, last: bool) -> Iterator[str]:
    yield f"{margin}{'└' if last else '├'}─ {_label(node)}"
    if not isinstance(node, Leaf):
        margin += "   " if last else "│  "
        yield from _lines(node.low, margin, last=False)
        yield from _lines(node.high, margin, last=True)


def _label(node: Node) -> str:
    if not isinstance(node, Leaf):
        return f"{'zyx'[node.axis_zyx]} = {node.plane}"
    if node.box.bricks == 0:
        return f"rank {node.rank}: no bricks"
    sides = zip("zyx", node.box.begin_zyx, node.box.end_zyx, strict=True)
    return f"rank {node.rank}: {', '.join(f'{a} {begin}…{end}' for a, begin, end in sides)}, cost {node.cost:.6g}"
