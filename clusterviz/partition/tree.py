"""BSP trees over bricks: planes between bricks at the nodes, the bricks of one rank at each leaf.

Every plane of a BSP tree separates its two sides, so no ray from the eye visits the far side before the near one. Index
space is an affine image of the world, which preserves planes and the order along rays. The order is therefore also
right for rotated, sheared and mirrored grids.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from clusterviz.errors import InputError

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
        z, y, x = self.shape_zyx
        return z * y * x

    @property
    def slices(self) -> tuple[slice, slice, slice]:
        """Slices of this box in an array over all bricks."""
        z, y, x = (slice(begin, end) for begin, end in zip(self.begin_zyx, self.end_zyx, strict=True))
        return z, y, x


@dataclass(frozen=True)
class Leaf:
    """Leaf of a tree: the bricks of one rank."""

    rank: int
    box: BrickBox  # its bricks; the boxes of all leaves contain each brick exactly once
    trimmed: BrickBox  # bounding box of its bricks with a cost above 0; empty (all zero) if there are none
    cost: float


@dataclass(frozen=True)
class Split:
    """Inner node: `low` has the bricks before `plane` along `axis_zyx`, and the lower ranks, `high` the others."""

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


Vector = tuple[float, float, float]


def front_to_back(tree: BspTree, eye_brick: Vector | None, direction_index: Vector) -> list[int]:
    """Sort the ranks by visibility.

    Returns every rank once, the nearest first. No ray visits a leaf of a later rank before one of an earlier rank. A
    position or direction that is not finite raises InputError.

    Reference: H. Fuchs, Z. Kedem, B. Naylor: On visible surface generation by a priori tree structures, SIGGRAPH 1980.

    Parameters
    ----------
    eye_brick : (x, y, z) position of the eye in bricks, or None for parallel projection; may lie inside the volume or
        on a plane
    direction_index : (x, y, z) view direction in index space, of any length; in perspective it is used only if the eye
        lies on a plane, where either order is right
    """
    check_finite(eye_brick, direction_index)
    ranks: list[int] = []
    _visit(tree.root, eye_brick, direction_index, ranks)
    return ranks


def check_finite(eye: Vector | None, direction: Vector) -> None:
    """Raise InputError if a position or direction is not finite."""
    if not all(map(math.isfinite, (*direction, *(eye or ())))):
        raise InputError("not finite", where="camera", found=f"eye {eye}, direction {direction}")


def _visit(node: Node, eye: Vector | None, direction: Vector, ranks: list[int]) -> None:
    if isinstance(node, Leaf):
        ranks.append(node.rank)
        return
    axis_xyz = 2 - node.axis_zyx
    # Signed distance from the eye to the plane: 0 for an eye on it, and in parallel projection.
    ahead = 0.0 if eye is None else node.plane - eye[axis_xyz]
    low_first = ahead > 0 or (ahead == 0 and direction[axis_xyz] >= 0)
    for side in (node.low, node.high) if low_first else (node.high, node.low):
        _visit(side, eye, direction, ranks)
