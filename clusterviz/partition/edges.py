"""Units of bricks, which are small near the planes of a tree and large elsewhere.

Ranks exchange whole units. Many units balance well and cost many messages. Units that are small only near the planes of
a tree balance as well with few messages (thesis, figure 5.10).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clusterviz.partition.tree import BspTree, Index, Leaf, Node

Edges = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]
"""For each axis (z, y, x) the bricks at which units but the first begin, rising, within 1 … bricks − 1."""


def refined_edges(tree: BspTree, coarsest: int = 8, fine: int = 2) -> Edges:
    """Fine near the planes of a tree, coarse between them and towards the borders.

    Reference: M. Strengert 2010, section 5.3.6 and figure 5.10 (bricks closer to a node transition are smaller).

    `tree`: where planes are now, or where an estimate puts them; `coarsest`: the longest side of a unit, in bricks;
    `fine`: units of each length on either side of a plane: of one brick, then of two, of four, … of `coarsest`.
    """
    planes = _planes(tree.root)
    z, y, x = (_refined(n, planes[axis], coarsest, fine) for axis, n in enumerate(tree.shape_zyx))
    return z, y, x


def units(shape_zyx: Index, edges: Edges) -> NDArray[np.int64]:
    """The number of each brick's unit, int64 (bz, by, bx), from 0."""
    z, y, x = (np.searchsorted(edge, np.arange(n), side="right") for edge, n in zip(edges, shape_zyx, strict=True))
    rows, columns = len(edges[1]) + 1, len(edges[2]) + 1
    number: NDArray[np.int64] = (z[:, None, None] * rows + y[:, None]) * columns + x
    return number


def _planes(node: Node) -> dict[int, set[int]]:
    if isinstance(node, Leaf):
        return {0: set(), 1: set(), 2: set()}
    below, above = _planes(node.low), _planes(node.high)
    found = {axis: below[axis] | above[axis] for axis in range(3)}
    found[node.axis_zyx].add(node.plane)
    return found


def _refined(bricks: int, planes: set[int], coarsest: int, fine: int) -> tuple[int, ...]:
    """The edges along one axis: from each plane both ways, by lengths that double, to the middle of the gap."""
    inside = {plane for plane in planes if 0 < plane < bricks}
    if not inside:
        return tuple(range(coarsest, bricks, coarsest))
    edges = set(inside)
    for low, high in pairwise(sorted({0, bricks, *inside})):
        # A border of the volume is no plane: towards it units only grow.
        middle = 0 if low == 0 else bricks if high == bricks else (low + high) // 2
        edges.add(middle)
        if low > 0:
            edges.update(low + step for step in _steps(middle - low, coarsest, fine))
        if high < bricks:
            edges.update(high - step for step in _steps(high - middle, coarsest, fine))
    return tuple(sorted(edges - {0, bricks}))


def _steps(length: int, coarsest: int, fine: int) -> Iterator[int]:
    """Distances below a length: `fine` steps of 1, of 2, of 4, … of `coarsest`."""
    at = 0
    for count in range(length):
        at += min(coarsest, 1 << count // fine)
        if at >= length:
            return
        yield at
