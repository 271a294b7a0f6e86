"""Visibility order of a BSP tree's leaves, the same for all rays of a camera.

Every plane of a BSP tree separates its two sides, so no ray from the eye visits the far side before the near one. Index
space is an affine image of the world, which preserves planes and the order along rays. The order is therefore also
right for rotated, sheared and mirrored grids.
"""

from __future__ import annotations

import math

from clusterviz.errors import InputError
from clusterviz.partition.tree import BspTree, Leaf, Node

Vector = tuple[float, float, float]


def front_to_back(tree: BspTree, eye_brick: Vector | None, direction_index: Vector) -> list[int]:
    """Sort the ranks by visibility.

    Parameters
    ----------
    tree : BSP tree
    eye_brick : (x, y, z) position of the eye in bricks, or None for parallel projection; may lie inside the volume or
        on a plane
    direction_index : (x, y, z) view direction in index space, of any length; in perspective it is used only if the eye
        lies on a plane, where either order is right

    Returns
    -------
    ranks : every rank once, the nearest first. No ray visits a leaf of a later rank before one of an earlier rank.

    Raises
    ------
    InputError
        A position or direction is not finite.

    References
    ----------
    H. Fuchs, Z. Kedem, B. Naylor: On visible surface generation by a priori tree structures, SIGGRAPH 1980.
    """
    if not all(map(math.isfinite, (*direction_index, *(eye_brick or ())))):
        raise InputError("not finite", where="camera", found=f"eye {eye_brick}, direction {direction_index}")
    ranks: list[int] = []
    _visit(tree.root, eye_brick, direction_index, ranks)
    return ranks


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
