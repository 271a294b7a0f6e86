"""The tree as text, for people: planes, and under them the ranks with their bricks and costs."""

from __future__ import annotations

from collections.abc import Iterator

from clusterviz.partition.tree import BspTree, Leaf, Node


def draw(tree: BspTree) -> str:
    """Draw a tree, a line a node.

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
