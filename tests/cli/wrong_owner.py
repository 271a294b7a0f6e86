"""clusterviz in which rank 1 owns all bricks (HOW is "twice") or none ("missed"): wrong_owner.py HOW ARGUMENTS…"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

from clusterviz.cli import run
from clusterviz.distribution import static
from clusterviz.partition import BrickBox, BspTree, Leaf, Node, build_tree


def main() -> int:
    """Change the partition that drawing uses, then do what the command line says."""
    static.build_tree = _build_wrongly  # type: ignore[attr-defined]
    return run(sys.argv[2:])


def _build_wrongly(cost: Any, ranks: int) -> BspTree:
    tree = build_tree(cost, ranks)
    whole = BrickBox((0, 0, 0), tree.shape_zyx)
    return replace(tree, root=_change(tree.root, whole if sys.argv[1] == "twice" else BrickBox((0, 0, 0), (0, 0, 0))))


def _change(node: Node, box: BrickBox) -> Node:
    if isinstance(node, Leaf):
        return replace(node, box=box, trimmed=box) if node.rank == 1 else node
    return replace(node, low=_change(node.low, box), high=_change(node.high, box))


if __name__ == "__main__":
    sys.exit(main())
